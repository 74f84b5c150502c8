"""Pictures a second of the explorer: python benchmarks/explorer_frames.py [--json FILE].

Pictures are drawn off screen as fast as possible, and counted as headless Chromium takes them from the page, at most 30
a second; with the plate alone and with the swarm. Rates are the median over a few seconds off screen, and the mean in
the browser. The processor time of one picture, over all threads, depends less on other work on the machine.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from peer_codes.machine import machine, versions

from warp_plate import Scene
from warp_plate.explore.live_model import LiveModel
from warp_plate.viz.availability import set_up_renderer
from warp_plate.viz.explorer_page import FONT_SIZE, SIZE
from warp_plate.viz.explorer_view import ROW_WEIGHTS, ExplorerView
from warp_plate.viz.pictures import make_plotter

NODES = (27, 105)
SECONDS = 5.0
BROWSERS = ("chromium-headless-shell", "chromium", "chromium-browser", "google-chrome")


def main() -> None:
    """Measure and print; with --json also into a file."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", type=Path, help="write the figures here")
    options = parser.parse_args()
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else None
    record = {"machine": machine(), "versions": versions(), "load": load, "rows": []}
    print(f"load average {load}\nnodes  where    showing  pictures/s  processor ms")
    for nodes in NODES:
        scene = paper(nodes)
        model = LiveModel(scene, "cpu")
        for showing in ("plate", "swarm"):
            row(record, nodes, "drawn", showing, *drawn(model, showing))
        model.close()
        for showing, rate in page(scene).items():
            row(record, nodes, "browser", showing, rate)
    if options.json:
        options.json.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")


def row(record: dict, nodes: int, where: str, showing: str, rate: float, processor: float | None = None) -> None:
    """Keep and print the pictures a second, and the processor's time [s] for one."""
    figures = {"pictures_a_second": round(rate, 1)}
    if processor is not None:
        figures["processor_ms"] = round(1000 * processor, 1)
    record["rows"].append({"nodes": nodes, "where": where, "showing": showing, **figures})
    print(f"{nodes:5}  {where:8} {showing:8}", *(f"{figure:10}" for figure in figures.values()), flush=True)


def paper(nodes: int) -> Scene:
    """The paper's scene on another grid."""
    scene = Scene.load("paper")
    return scene.model_copy(update={"grid": scene.grid.model_copy(update={"nodes": (nodes, nodes), "time_step": None})})


def drawn(model: LiveModel, showing: str) -> tuple[float, float]:
    """Return the pictures a second drawn off screen, and the processor time of one [s]."""
    set_up_renderer()
    plotter = make_plotter(SIZE, off_screen=True, shape=(2, 1), row_weights=list(ROW_WEIGHTS))
    view = ExplorerView(plotter, model, FONT_SIZE)
    plotter.show(auto_close=False, interactive=False)
    if showing == "swarm":
        model.choose("found")
        model.wait()
    times, used = [], time.process_time()
    until = time.perf_counter() + SECONDS
    while (started := time.perf_counter()) < until:
        view.advance(0.02)
        plotter.render()
        times.append(time.perf_counter() - started)
    used = time.process_time() - used
    plotter.close()
    return 1 / statistics.median(times), used / len(times)


def page(scene: Scene) -> dict[str, float]:
    """Pictures a second that Chromium takes; nothing where there is none."""
    from playwright.sync_api import sync_playwright

    browser_path = next(filter(None, map(shutil.which, BROWSERS)), None)
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        file = Path(folder, "panel.toml")
        file.write_text(scene.to_toml(), encoding="utf-8")
        command = [sys.executable, "-m", "warp_plate", "explore", str(file), "--web", "--port", "0"]
        server = subprocess.Popen([*command, "--device", "cpu"], stdout=subprocess.PIPE, text=True)
        try:
            address = re.search(r"http://\S+", server.stdout.readline()).group()
            browser = playwright.chromium.launch(executable_path=browser_path, args=["--no-sandbox"])
            tab = browser.new_page(viewport={"width": 1290, "height": 800})
            tab.goto(address)
            tab.wait_for_selector("#stage img")
            rates = {}
            for showing in ("plate", "swarm"):
                if showing == "swarm":
                    tab.click("#choose-found")
                tab.wait_for_timeout(1000)
                first, started = taken(tab), time.perf_counter()
                tab.wait_for_timeout(1000 * SECONDS)
                rates[showing] = (taken(tab) - first) / (time.perf_counter() - started)
            browser.close()
        finally:
            server.terminate()
            server.wait()
    return rates


def taken(tab: object) -> int:
    """Return the numbers of pictures sent to the browser and taken by it."""
    return tab.evaluate("window.trame.state.get('picture')")


if __name__ == "__main__":
    main()

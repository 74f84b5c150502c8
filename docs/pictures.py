"""Draws the pictures of docs/images, each by the commands of warp-plate or the script that stand beside its name here.

    python docs/pictures.py                     # all of them: half an hour on two cores
    python docs/pictures.py targets sweep-paper # these

The window needs Xvfb and xdotool, the two pages Playwright and Chromium.
"""

from __future__ import annotations

import os
import re
import runpy
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

DOCS = Path(__file__).resolve().parent
MEASURED = DOCS.parent / "benchmarks" / "results"
# Widths that are tried [pixels], and the size from which a PNG is written with 256 colours, and then narrower [bytes].
WIDTHS, MOST_BYTES = (1400, 1200, 1000, 800), 280_000
THREE = "--case equal --case single --case best"
PLAN = "--plan --field rms-velocity"
# Commands of warp-plate, in a folder with the scenes of docs/examples, and the picture that they write.
COMMANDS = {
    "bounds-strong-and-quiet.png": ("strong-and-quiet-localize-history.png", "localize strong-and-quiet.toml"),
    "baselines.png": (
        "mask-localize.png",
        "localize mask.toml --baselines",
        f"render mask-localize.h5 {PLAN} --limits each --case time_reversal --case inverse_filter --case best",
    ),
    "coils.png": (
        "pmma-frf.png",
        "frf exciters/pmma.toml --quantity impedance --range 20:5000",
    ),
    "crosstalk.png": ("three-targets-localize-crosstalk.png", "localize three-targets.toml"),
    "focusing-four-fingers.png": ("four-fingers-focus.png", "focus four-fingers"),
    "focusing.gif": (
        "focus.gif",
        "focus focusing-glass",
        "render focusing-glass-focus.h5 --case time_reversal --case optimum --width 280 --frames 16 "
        "--rate 8 --out focus.gif",
    ),
    "focusing.png": ("focusing-glass-focus.png", "focus focusing-glass"),
    "frequency-response.png": ("touch-panel-frf.png", "frf touch-panel"),
    "design-exciter.png": ("design-exciter.designed.png", "design design-exciter.toml"),
    "design-quiet.png": ("design-quiet.designed.png", "design design-quiet.toml"),
    "design-resonators.png": ("design-resonators.designed.png", "design design-resonators.toml"),
    "design-ribs.png": ("design-ribs.designed.png", "design design-ribs.toml"),
    "design-thickness.png": ("design-thickness.designed.png", "design design-thickness.toml"),
    "design-two-targets.png": ("design-two-targets.designed.png", "design design-two-targets.toml"),
    "sound.png": ("touch-panel-sound.png", "sound touch-panel"),
    "sound-localization.png": (
        "console-sweep.png",
        "sweep console --what localize --set search.limits.least_velocity=2e-3 --set search.magnitude.range=[0,7812.5] "
        "--set search.phase={} --vary search.limits.sound=22:50:29",
    ),
    "objectives-phases-alone.png": (
        "phases-alone-localize.png",
        "localize phases-alone.toml",
        f"render phases-alone-localize.h5 {PLAN} --case equal --case best",
    ),
    "objectives-strong-and-quiet.png": (
        "strong-and-quiet-localize.png",
        "localize strong-and-quiet.toml",
        f"render strong-and-quiet-localize.h5 {PLAN} --case equal --case best",
    ),
    "outlines-trackpad.png": ("trackpad-modes.png", "modes trackpad"),
    "outlines-watch.png": ("watch-localize-surfaces.png", "localize watch"),
    "paper-accuracy.png": ("paper-accuracy.png", "accuracy paper"),
    "paper-surfaces.png": ("paper-localize-surfaces.png", "localize paper"),
    "robust-touch-panel.png": ("robust-touch-panel-localize-robust.png", "localize robust-touch-panel.toml"),
    "searching-bursts.png": (
        "bursts-localize.png",
        "localize bursts.toml",
        f"render bursts-localize.h5 {PLAN} --case equal --case best --start 0.01 --end 0.014",
    ),
    "searching-frequency.png": ("frequency-localize-spectrum.png", "localize frequency.toml"),
    "searching-position.png": (
        "places-localize.png",
        "localize places.toml",
        f"render places-localize.h5 {PLAN} --limits each --case single --case best",
    ),
    "specify-console.png": ("console-specify.png", "specify console"),
    "specify-tolerances.png": (
        "console-specify.png",
        "specify console --set specification.tolerance={gasket=0.3}",
    ),
    "sweep-paper.png": (
        "paper-sweep.png",
        "sweep paper --vary drive.frequency=200:400:41 effects.damping.viscous=log:10:300:17",
    ),
    "view-modes.png": ("modes.png", "localize paper", "render paper-localize.h5 --modes 3 --out modes.png"),
    "view-motion.gif": (
        "motion.gif",
        "localize paper",
        f"render paper-localize.h5 {THREE} --width 280 --frames 14 --rate 10 --out motion.gif",
    ),
    "view-phase-plan.png": (
        "phase.png",
        "localize paper",
        f"render paper-localize.h5 {THREE} --plan --field phase --out phase.png",
    ),
    "view-rms-velocity.png": (
        "rms.png",
        "localize paper",
        f"render paper-localize.h5 {THREE} --field rms-velocity --out rms.png",
    ),
}
# Scripts of the gallery, by the picture that is their figure.
SCRIPTS = {
    f"explain-{path.stem.removeprefix('plot_').replace('_', '-')}.png": path
    for path in DOCS.glob("examples/gallery/explanations/*.py")
}
SCRIPTS["outlines.png"] = DOCS / "examples" / "gallery" / "plates" / "plot_outlines.py"
done: set[str] = set()


def main(chosen: list[str]) -> None:
    drawn = {**dict.fromkeys(COMMANDS, by_commands), **dict.fromkeys(SCRIPTS, by_script), **OTHERS}
    names = [name for name in drawn if not chosen or Path(name).stem in chosen]
    with tempfile.TemporaryDirectory() as folder:
        shutil.copytree(DOCS / "examples", folder, dirs_exist_ok=True)
        os.chdir(folder)
        for name in names:
            print(f"{name} ...", flush=True)
            publish(drawn[name](name), DOCS / "images" / name)


def publish(written: Path, target: Path) -> None:
    """Copy a picture, a PNG not wider and not larger than a page can bear."""
    from PIL import Image

    if target.suffix != ".png":
        shutil.copy(written, target)
        return
    whole = Image.open(written).convert("RGB")
    for width in WIDTHS:
        picture = whole
        if whole.width > width:
            picture = whole.resize((width, round(whole.height * width / whole.width)), Image.Resampling.LANCZOS)
        picture.save(target, optimize=True)
        if target.stat().st_size > MOST_BYTES:
            palette = picture.quantize(255, Image.Quantize.MEDIANCUT)
            palette.putpalette([*palette.getpalette()[:765], 255, 255, 255])
            picture = picture.quantize(palette=palette, dither=Image.Dither.FLOYDSTEINBERG)
            picture.putpalette([255 if level > 247 else level for level in picture.getpalette()])  # a white background
            picture.save(target, optimize=True)
        if target.stat().st_size <= MOST_BYTES:
            return


def warp_plate(command: str) -> None:
    """Run a command once."""
    if command not in done:
        subprocess.run([sys.executable, "-m", "warp_plate", *command.split()], check=True, stdout=subprocess.DEVNULL)
        done.add(command)


def by_commands(name: str) -> Path:
    written, *commands = COMMANDS[name]
    for command in commands:
        warp_plate(command)
    return Path(written)


def by_script(name: str) -> Path:
    from matplotlib import pyplot

    pyplot.switch_backend("Agg")
    runpy.run_path(str(SCRIPTS[name]))
    pyplot.gcf().savefig(name, dpi=150)
    pyplot.close("all")
    return Path(name)


def hard_cases(name: str) -> Path:
    """Draw the figures that ``benchmarks/hard_cases`` has measured."""
    columns = [f"CPU={MEASURED}/hard-cases-cpu.json", f"H200={MEASURED}/hard-cases-h200.json"]
    program = str(DOCS.parent / "benchmarks" / "hard_cases")
    subprocess.run([sys.executable, program, "--picture", name, *columns], check=True)
    return Path(name)


def measured_panels(name: str) -> Path:
    """Draw the curves that ``benchmarks/measured_exciters.py`` has compared."""
    program = str(DOCS.parent / "benchmarks" / "measured_exciters.py")
    curves = str(MEASURED / "measured-panels.json")
    subprocess.run([sys.executable, program, curves, "--picture", name], check=True)
    return Path(name)


def targets(name: str) -> Path:
    """Draw one motion with targets of three shapes."""
    from dataclasses import replace

    import warp_plate as wpl
    from warp_plate.analysis.motion import motions
    from warp_plate.viz.fields import PictureStyle
    from warp_plate.viz.plots.plan import draw_plan

    paper = wpl.Scene.load("paper")
    star = [(0.1, 0.165), (0.118, 0.12), (0.165, 0.118), (0.128, 0.09), (0.141, 0.045), (0.1, 0.07), (0.059, 0.045)]
    star += [(0.072, 0.09), (0.035, 0.118), (0.082, 0.12)]
    drawn = []
    for shape, value in {"disc": (0.07, 0.08, 0.04), "polygon": star, "mask": "finger.csv"}.items():
        Path(f"{shape}.toml").write_text(paper.with_tables(target={shape: value}).to_toml())
        scene = wpl.Scene.load(f"{shape}.toml")  # from a file, for masks lie beside it
        result = wpl.simulate(scene, drive="equal", device="cpu", estimate=False)
        (motion,) = motions(scene, result.cases, device="cpu")
        drawn.append(replace(motion, name=shape, scene=scene))
    draw_plan(paper, drawn, Path(name), PictureStyle("rms-velocity"), 0)
    return Path(name)


def bracket(name: str) -> Path:
    """Draw the plan of a bracket with holes, held by two bolts."""
    import warp_plate as wpl
    from warp_plate.viz.plots.plan import draw_layout

    corners = [(0, 0), (0.12, 0), (0.12, 0.04), (0.04, 0.04), (0.04, 0.12), (0, 0.12)]
    holes = [{"disc": (x, 0.02, 0.005), "edge": "clamped"} for x in (0.06, 0.1)]
    steel = {"thickness": 2e-3, "young_modulus": 2e11, "poisson_ratio": 0.3, "density": 7850.0}
    scene = wpl.Scene(
        plate=steel | {
            "outline": {"polygon": corners, "corner_radius": 0.006}, "holes": [*holes, {"disc": (0.02, 0.1, 0.008)}],
        },
        edges={"outline": "free"}, supports=[{"line": ((0.0, 0.04), (0.04, 0.04))}], drive=wpl.Drive(frequency=400),
        actuators=[wpl.Actuator(name="A", disc=(0.02, 0.065, 0.008)), wpl.Actuator(name="B", disc=(0.02, 0.02, 0.008))],
        target=wpl.Target(area=(0.0, 0.04, 0.08, 0.12)),
    )  # fmt: skip
    draw_layout(scene, Path(name))
    return Path(name)


def page(name: str) -> Path:
    """Photograph the page that ``render`` writes."""
    warp_plate("localize paper")
    warp_plate(f"render paper-localize.h5 {THREE} --out page.html")
    with chromium() as browser:
        tab = browser.new_page(viewport={"width": 1400, "height": 460})
        tab.goto(Path("page.html").resolve().as_uri())
        tab.wait_for_timeout(500)
        tab.keyboard.press("Space")
        tab.evaluate("go(24)")
        tab.wait_for_timeout(500)
        tab.screenshot(path=name)
    return Path(name)


def explorer(name: str) -> Path:
    """Photograph the page of ``explore`` after its search."""
    command = [sys.executable, "-m", "warp_plate", "explore", "paper", "--web", "--port", "0", "--device", "cpu"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server, chromium() as browser:
        try:
            assert server.stdout is not None
            tab = browser.new_page(viewport={"width": 1360, "height": 860})
            tab.goto(re.search(r"http://\S+", server.stdout.readline())[0])  # type: ignore[index]
            tab.wait_for_selector("#stage img")
            tab.click("#choose-found")
            tab.wait_for_timeout(9000)
            tab.screenshot(path=name)
        finally:
            server.terminate()
    return Path(name)


def window(name: str) -> Path:
    """Take a picture of the window on a virtual display."""
    from PIL import ImageGrab

    warp_plate("localize paper")
    reading, writing = os.pipe()
    screen = ["-screen", "0", "1600x1000x24", "-nolisten", "tcp", "-noreset"]
    with subprocess.Popen(["Xvfb", "-displayfd", str(writing), *screen], pass_fds=[writing]) as server:
        os.close(writing)
        os.environ["DISPLAY"] = ":" + os.fdopen(reading).readline().strip()
        command = [sys.executable, "-m", "warp_plate", "view", "paper-localize.h5", *THREE.split()]
        with subprocess.Popen(command) as viewer:
            at = ["mousemove", "--window", "%1", "400", "200"]
            subprocess.run(
                ["xdotool", "search", "--sync", "--onlyvisible", "--name", "warp-plate view", *at], check=True
            )
            for key in ("space", "c", "c", "c"):
                subprocess.run(["xdotool", "key", key], check=True)
                time.sleep(1.5)
            screen_shot = ImageGrab.grab(xdisplay=os.environ["DISPLAY"])
            screen_shot.crop(screen_shot.getbbox()).save(name)  # the screen behind is black
            viewer.terminate()
        server.terminate()
    return Path(name)


class chromium:
    """Headless Chromium of the system, else of Playwright, as a context."""

    def __enter__(self) -> Any:
        from playwright.sync_api import sync_playwright

        names = ("chromium-headless-shell", "chromium", "chromium-browser", "google-chrome")
        self.started = sync_playwright().start()
        found = next(filter(None, map(shutil.which, names)), None)
        return self.started.chromium.launch(executable_path=found, args=["--no-sandbox"])

    def __exit__(self, *_: object) -> None:
        self.started.stop()


OTHERS = {"explore-page.png": explorer, "hard-cases.png": hard_cases, "outlines-bracket.png": bracket}
OTHERS |= {"measured-panels.png": measured_panels}
OTHERS |= {"targets.png": targets, "view-page.png": page, "view-window.png": window}

if __name__ == "__main__":
    main(sys.argv[1:])

"""Compare search methods on a scene: each from several seeds, with the same number of evaluations.

    python benchmarks/compare_methods.py paper --methods pso,gradient,exact --seeds 3

prints for each method the best, median and worst value of the search over the seeds (the localization factor, or the
weighted sum of the objectives), the distance of the median from the bound, and the median of evaluations and seconds.
Methods run in turn for each seed, so that disturbances of the machine affect all of them. The seconds are those of
``localize`` without compilation, measured after a first search of each method that does not count. A method makes at
most particles × iterations evaluations. One that does not fit the scene is left out with the reason.
"""

from __future__ import annotations

import argparse
import time

import numpy as np

import warp_plate as wpl

METHODS = ("pso", "constriction", "ring", "cma", "gradient", "exact")
ROW = "{:<13}{:>12}{:>12}{:>12}{:>10}{:>7}{:>10}"


def search(scene: wpl.Scene, seed: int, options: argparse.Namespace) -> tuple[float, float, float, float]:
    """Return the best value of a search, its bound (NaN if unknown), its evaluations and its seconds."""
    started = time.perf_counter()
    result = wpl.localize(
        scene, seed=seed, device=options.device, evaluator=options.evaluator, estimate=False, spectrum=False
    )
    seconds = time.perf_counter() - started - result.seconds["compile"]
    bound = result.bound if result.only_localization else result.objective_values.get("bound")
    return result.history["best"][-1], np.nan if bound is None else bound, result.evaluations, seconds


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter, allow_abbrev=False
    )
    parser.add_argument("scene", help="a preset or a TOML file")
    parser.add_argument("--methods", default=",".join(METHODS), help="default: %(default)s")
    parser.add_argument("--seeds", type=int, default=10, help="number of seeds, from the scene's own on")
    parser.add_argument("--evaluator", choices=("direct", "response", "modal"))
    parser.add_argument("--device", default="auto")
    options = parser.parse_args()
    scene, scenes = wpl.Scene.load(options.scene), {}
    for method in options.methods.split(","):
        try:
            candidate = scene.with_tables(search={"method": method})
            search(candidate, scene.search.seed, options)
            scenes[method] = candidate
        except wpl.SceneError as error:
            print(f"{method}: left out: {error}")
    records = {method: [] for method in scenes}
    for seed in range(scene.search.seed, scene.search.seed + options.seeds):
        for method, candidate in scenes.items():
            records[method].append(search(candidate, seed, options))
    print(ROW.format("method", "best", "median", "worst", "gap", "tried", "seconds"))
    for method, rows in records.items():
        values, bounds, tried, seconds = np.array(rows).T
        median = np.median(values)
        shown = [f"{value:.6g}" for value in (values.max(), median, values.min())]
        gap, work = f"{np.median(bounds) - median:.1e}", f"{np.median(tried):.0f}"
        print(ROW.format(method, *shown, gap, work, f"{np.median(seconds):.2g}"))


if __name__ == "__main__":
    main()

"""How fast `crar-drake play` can go, without a browser and without waiting.

    python -m benchmarks.play_rate [--scenario dance] [--periods 0.005,0.001]

For each control period: seconds of the processor for a simulated one, of the steps and
of the pictures (30 a second), and the real-time factor that this allows; the median,
the 99th percentile and the longest of the steps. Processor time, so that what else the
computer does counts less.
"""

import argparse
import time

import numpy as np
from pydrake.geometry import Meshcat

from crar_drake.play.live_scene import LiveScene
from crar_drake.play.live_simulation import LiveSimulation
from crar_drake.play.pacing import Pacer
from crar_drake.simulation.scenario import load_scenario

_FRAME = 1.0 / 30.0  # [s]


def measure(scenario: str, period: float, duration: float) -> str:
    """A line of the table."""
    loaded = load_scenario(scenario)
    loaded.controller.period = period
    live = LiveSimulation(loaded)
    live.compile()
    scene, pacer = LiveScene(live, Meshcat()), Pacer(0.0)
    steps, pictures, drawn = [], 0.0, -_FRAME
    began = time.process_time()
    while live.time < duration:
        before = time.process_time()
        live.step()
        after = time.process_time()
        steps.append(after - before)
        if live.time - drawn >= _FRAME:
            drawn = live.time
            scene.frame(pacer, live.time, "")
            pictures += time.process_time() - after
    whole = (time.process_time() - began) / live.time
    milliseconds = 1e3 * np.percentile(steps, [50, 99, 100])
    return (
        f"{1e3 * period:6g} ms {sum(steps) / live.time:8.3f} s "
        f"{pictures / live.time:8.3f} s {1.0 / whole:8.2f} x"
        + "".join(f"{ms:8.2f} ms" for ms in milliseconds)
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--scenario", default="dance")
    parser.add_argument("--periods", default="0.005,0.001")
    parser.add_argument("--duration", type=float, default=10.0)
    arguments = parser.parse_args()
    print("   period     steps  pictures    factor     median        p99    longest")
    for period in arguments.periods.split(","):
        print(measure(arguments.scenario, float(period), arguments.duration))


if __name__ == "__main__":
    main()

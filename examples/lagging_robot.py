"""A position-controlled robot in simulation that lags, for `crar-drake serve`.

    crar-drake serve --start measured --tracking-error 0.2 --latency 0.01 &
    python examples/lagging_robot.py --lag 0.02 --late 0.01 --loss 0.1 &
    python examples/teleoperate.py

It goes to each command that it hears, by a first-order lag, and says where it is. What
it says arrives late, and a share of all messages is lost. At the end it tells how far
it was from what it was told, and judges its motion by means of its own.
"""

import argparse
import json
import math
import random
import socket
import time
from collections import deque

import numpy as np

from crar_drake.judging.referee import Referee
from crar_drake.simulation.diagram import PrepareScenario
from crar_drake.simulation.scenario import load_scenario

SILENCE = 2.0  # [s] after which the server has ended


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--host", default="127.0.0.1")
    parser.add_argument("--port", type=int, default=7670)
    parser.add_argument("--scenario", default="dance_wrists", help="as the server's")
    parser.add_argument("--lag", type=float, default=0.02, help="time constant [s]")
    parser.add_argument("--late", type=float, default=0.0, help="of what it says [s]")
    parser.add_argument("--loss", type=float, default=0.0, help="share of messages")
    parser.add_argument(
        "--off", type=float, default=0.05, help="from rest, first [rad]"
    )
    options = parser.parse_args()

    model = PrepareScenario(load_scenario(options.scenario)).model
    names, q = list(model.position_names), model.rest_positions()
    controlled = model.controlled_positions[: model.n]
    q[controlled] = np.clip(q[controlled] + options.off, model.lower, model.upper)
    rng, told, error = random.Random(0), q.copy(), 0.0
    said: deque[tuple[float, bytes]] = deque()
    positions, statuses = [], {}
    server = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    server.connect((options.host, options.port))
    server.setblocking(False)
    before, last = time.monotonic(), math.inf
    while (now := time.monotonic()) - last < SILENCE:
        while command := heard(server):
            if rng.random() >= options.loss and "positions" in command:
                told, last = np.array(command["positions"]), now
                status = command["status"]
                statuses[status] = statuses.get(status, 0) + 1
        q = q + (1.0 - math.exp((before - now) / options.lag)) * (told - q)
        error, before = max(error, np.abs(told - q).max()), now
        positions.append(q)
        measured = {"measured": dict(zip(names, q.tolist(), strict=True))}
        said.append((now + options.late, json.dumps(measured).encode()))
        while said and said[0][0] <= now:
            _, line = said.popleft()
            if rng.random() >= options.loss:
                try:
                    server.send(line)
                except OSError:
                    pass  # nobody there, or a full buffer: lost, as on any network
        time.sleep(0.004)

    print(f"{sum(statuses.values())} commands: {statuses}")
    print(f"at most {error:.3f} rad from what it was told last")
    judged = Referee(model.plant, model.scene_graph, model.description.pairs)
    found = judged.violations(np.array(positions)[::5])
    print(
        f"{found.num_violated} of {found.num_samples} positions in violation, smallest "
        f"distance {1e3 * found.smallest_distance:.1f} mm"
    )


def heard(server: socket.socket) -> dict | None:
    """The next command, if there is one."""
    try:
        return json.loads(server.recv(65536))
    except OSError:
        return None


if __name__ == "__main__":
    main()

"""What does the certificate of meshes cost, and how much of a motion does it show?

    python -m benchmarks.mesh_clearance g1_whole_body dance.csv walk.csv

On one core, without reading robot and files. A pair touches on a way, too, if it does
at one of its ends.
"""

import argparse
import time
from pathlib import Path

import numpy as np

from benchmarks.tables import markdown_table
from crar_drake.references.mesh_clearance import ClearanceOfMeshes
from crar_drake.references.motion_files import read_motions
from crar_drake.references.whole_body import WholeBody
from crar_drake.robot.description import load_robot_description

HEADER = (
    "motion",
    "frames",
    "processor [s]",
    "x real time",
    "distances measured",
    "pairs and frames",
    "of them touching",
    "pairs and ways",
    "of them touching",
    "not shown",
    "nearest that are clear, frames and ways [mm]",
)


def main() -> None:
    """Prints a row for each motion of the files."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("robot", help="its name or folder")
    parser.add_argument("motions", nargs="+", help="files")
    arguments = parser.parse_args()
    description = load_robot_description(arguments.robot).without_ground()
    robot = WholeBody(description)
    began = time.process_time()
    meshes = ClearanceOfMeshes(robot)
    meshes.find(np.clip(np.zeros((2, robot.n)), robot.lower, robot.upper))  # compiled
    print(
        f"{len(meshes.meshes.pairs)} pairs; {len(meshes.meshes.not_of.as_built)} touch "
        f"as built; made ready in {time.process_time() - began:.1f} s\n"
    )
    rows = []
    for path in arguments.motions:
        for motion in read_motions(path, robot=robot):
            began = time.process_time()
            found = meshes.find(motion.joint_positions)
            took = time.process_time() - began
            clear = found.on_ways.min(axis=1, initial=np.inf) > 0.0
            nearest = [
                f"{1e3 * each[clear].min(initial=np.inf):.2f}"
                for each in (found.at_frames, found.on_ways)
            ]
            rows.append(
                (
                    f"{Path(path).name} {motion.clip}".strip(),
                    motion.num_frames,
                    f"{took:.2f}",
                    f"{(motion.num_frames - 1) / motion.rate / took:.1f}",
                    found.num_measured,
                    found.at_frames.size,
                    int(found.touch_at.sum()),
                    found.on_ways.size,
                    int(found.touch_on.sum()),
                    int(found.not_shown.sum()),
                    ", ".join(nearest),
                )
            )
    print(markdown_table(HEADER, [[str(cell) for cell in row] for row in rows]))


if __name__ == "__main__":
    main()

"""A few frames of a built-in motion, as files of a person's motion."""

from pathlib import Path

from crar_drake.motion.catalogue import resolve

# A skeleton of one bone, with the lengths of the CMU database.
ONE_BONE = """\
:version 1.10
:name one_bone
:units
  mass 1.0
  length 0.45
  angle deg
:root
   order TX TY TZ RX RY RZ
   axis XYZ
   position 0 0 0
   orientation 0 0 0
:bonedata
  begin
     id 1
     name spine
     direction 0 1 0
     length 9
     axis 0 0 0  XYZ
    dof rx
    limits (-90.0 90.0)
  end
:hierarchy
  begin
    root spine
  end
"""


def short_amc(folder: Path, stem: str, frames: int = 31, of: str = "dance") -> Path:
    """Writes the first frames, 60 a second, and the skeleton beside them.

    Args:
        folder: is made.
        stem: of both files.
        frames: how many.
        of: name of the built-in motion.
    """
    files = resolve(of)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{stem}.asf").write_bytes(files.asf.read_bytes())
    text = files.amc.read_text()
    path = folder / f"{stem}.amc"
    path.write_text(text[: text.index(f"\n{frames + 1}\n") + 1])
    return path

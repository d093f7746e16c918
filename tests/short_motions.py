"""A few frames of a built-in motion, as files of a person's motion."""

from pathlib import Path

from crar_drake.motion.catalogue import resolve


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

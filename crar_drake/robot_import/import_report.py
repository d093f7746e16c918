"""What an import tells of what it made of a robot."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from crar_drake.robot.description import IMPORT_FILE
from crar_drake.robot_import.capsule_fitting import Fit, FittedCapsule
from crar_drake.robot_import.choices import ImportChoices

# Takes what is being done, and the share that is done.
Progress = Callable[[str, float], None]


@dataclass
class ImportReport:
    """What an import made of a robot."""

    folder: Path  # that it wrote
    choices: ImportChoices  # all that was decided
    # key of the import file to how it was guessed, of new ones
    guessed: dict[str, str] = field(default_factory=dict)
    fits: dict[str, Fit] = field(default_factory=dict)  # link to its capsules
    # link without capsules to the link whose capsules enclose it
    covered: dict[str, str] = field(default_factory=dict)
    # everything else that the user should know, one line each
    notes: list[str] = field(default_factory=list)
    # what is likely to be wrong, or leaves the robot unprotected
    warnings: list[str] = field(default_factory=list)

    @property
    def file(self) -> Path:
        """The import file."""
        return self.folder / IMPORT_FILE

    def capsules(self) -> dict[str, tuple[FittedCapsule, ...]]:
        """Link to its capsules, of those that have some of their own."""
        return {n: f.capsules for n, f in self.fits.items() if n not in self.covered}

    def note(self, what: str, names: Sequence[str]) -> None:
        """A line that tells what is so of some names, if there are any."""
        if names:
            self.notes.append(f"{what}: {', '.join(names)}")

    def lines(self) -> list[str]:
        """The report as text."""
        lines = [f"robot {self.choices.name}, from {self.choices.source}", ""]
        lines += [
            "link: capsules, vertices within 5 mm, how far they stick out of the hull, "
            "volume over the hull's"
        ]
        for link, fit in self.fits.items():
            if link in self.covered:
                lines.append(f"  {link}: none, inside those of {self.covered[link]}")
                continue
            bound = self.choices.excess
            bad = "" if fit.good(bound) else f"  MISSES 5 mm or {1e3 * bound:g} mm"
            lines.append(
                f"  {link}: {len(fit.capsules)}, {100 * fit.coverage:.1f} %, "
                f"{1e3 * fit.excess:.0f} mm, {fit.volume_ratio:.2f}{bad}"
            )
        pairs = self.choices.pairs or []
        lines += ["", f"watched pairs: {len(pairs)}"]
        if self.warnings:
            lines += ["", *(f"WARNING: {warning}" for warning in self.warnings)]
        if self.notes:
            lines += ["", *self.notes]
        if self.guessed:
            lines += ["", f"guessed; correct it in {IMPORT_FILE} and import again:"]
            lines += [f"  {key}: {how}" for key, how in self.guessed.items()]
        return lines

"""`make docs`: a site of the pages, with the reference of the public names."""

import subprocess
import sys
from pathlib import Path

import pytest

import crar_drake

ROOT = Path(__file__).resolve().parents[1]


@pytest.mark.slow
def test_the_site_has_all_pages_and_public_names(tmp_path):
    pytest.importorskip("sphinx", reason="needs the extra: .[docs]")
    command = [sys.executable, "-m", "sphinx", "-q", "-W", "--keep-going"]
    command += ["-c", "docs/site", "-d", tmp_path / "read", ".", tmp_path / "site"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    site = tmp_path / "site"
    for page in [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]:
        assert (site / page.relative_to(ROOT).with_suffix(".html")).is_file(), page
    reference = (site / "docs/site/reference.html").read_text("utf-8")
    for name in crar_drake.__all__:
        assert f'id="crar_drake.{name}"' in reference, name
    assert "estimated_state" in reference

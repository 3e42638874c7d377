"""README's film is made by one command: a run is well, a unit is killed, and the run is well again."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest
from browsed import CHROMIUM

FILM = Path(__file__).parents[2] / "experiments" / "operating" / "film.py"


def test_the_film_shows_a_kill_and_its_repair(tmp_path: Path) -> None:
    pytest.importorskip("playwright.sync_api", reason="playwright is not installed (extra dev)")
    image = pytest.importorskip("PIL.Image", reason="pip install 'cfgplan[plots]'")
    if not CHROMIUM.exists():
        pytest.skip("there is no Chromium at /usr/bin/chromium")
    film = tmp_path / "film.png"
    command = [sys.executable, str(FILM), "--out", str(film)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    # Warnings may stand in between: a busy computer gives nothing for seconds.
    assert re.search(r": well .*\bbad .*\bwell; ", done.stdout), done.stdout
    with image.open(film) as shown:
        assert shown.is_animated

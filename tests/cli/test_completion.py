"""`cfgplan completion`: the script that it prints completes in a real bash, and is one that zsh takes."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest
from command import MODELS, Run

pytest.importorskip("shtab")


@pytest.fixture(scope="session")
def script(tmp_path_factory: pytest.TempPathFactory) -> Path:
    from cfgplan.cli import completion

    file = tmp_path_factory.mktemp("shell") / "cfgplan.bash"
    file.write_text(completion.script("bash"))
    return file


@pytest.mark.parametrize(
    ("words", "offered"),
    [
        (("so",), {"solve"}),
        (("solve", "--max"), {"--max-cost"}),
        (("solve", "--reasoner", "her"), {"hermit"}),
        (("ctl", "lose"), {"lose-host"}),
        (("help", "tutor"), {"tutorial"}),
        (("check", "off"), {"office.yaml", "office.expected.yaml"}),
        (("completion", ""), {"bash", "zsh"}),
    ],
)
def test_bash_completes_verbs_options_values_pages_and_files(
    script: Path, words: tuple[str, ...], offered: set[str]
) -> None:
    ask = 'source "$0"; COMP_WORDS=(cfgplan "$@"); COMP_CWORD=$#; _shtab_cfgplan; printf "%s\\n" "${COMPREPLY[@]}"'
    call = ["bash", "--norc", "-c", ask, str(script), *words]
    said = subprocess.run(call, capture_output=True, text=True, check=True, cwd=MODELS / "building")
    assert said.stderr == ""
    assert set(said.stdout.split()) == offered


def test_zsh_gets_a_script_of_its_own(run: Run, tmp_path: Path) -> None:
    out = run("completion", "zsh").out
    assert out.startswith("#compdef cfgplan")
    if zsh := shutil.which("zsh"):
        file = tmp_path / "_cfgplan"
        file.write_text(out)
        subprocess.run([zsh, "-n", file], check=True)


def test_without_the_extra_it_is_asked_for_by_name(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cfgplan.extras.is_there", lambda package: package != "shtab")
    result = run("completion", "bash")
    assert result.code == 30
    assert "pip install 'cfgplan[completion]'" in result.err

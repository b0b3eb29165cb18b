"""README's Python snippets run as printed, and a user's ``mypy --strict`` passes on them."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import hil

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")
SNIPPETS = re.findall(r"```python\n(.*?)```", README, re.DOTALL)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the files that the snippets read."""
    made = tmp_path_factory.mktemp("readme")
    hil.run_experiment(made / "run.mcap", duration_s=1.5, setpoints={"vertical": "step:0.05@0.5"})
    random = np.random.default_rng(1)
    u = np.repeat(random.choice([-0.4, 0.4], 300), 12)
    y = np.zeros(len(u))
    for k in range(1, len(u)):
        y[k] = 0.98 * y[k - 1] + 0.01 * u[k - 1]
    rows = np.column_stack([np.arange(len(u)) * 0.0112, u, y + 1e-4 * random.standard_normal(len(u))])
    np.savetxt(made / "data.csv", rows, delimiter=",", header="time_s,u,y", comments="")
    return made


def test_there_are_snippets_for_each_package() -> None:
    assert len(SNIPPETS) >= 4
    assert any("import design" in snippet for snippet in SNIPPETS)


@pytest.mark.parametrize("number", range(len(SNIPPETS)))
def test_a_snippet_runs_as_printed(number: int, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    exec(compile(SNIPPETS[number], f"README snippet {number + 1}", "exec"), {})


def test_a_users_strict_type_checker_accepts_the_snippets(folder: Path) -> None:
    paths = []
    for number, snippet in enumerate(SNIPPETS):
        path = folder / f"snippet_{number}.py"
        path.write_text(snippet)
        paths.append(str(path))
    options = "strict = True\nfollow_imports = silent\n[mypy-control.*]\nignore_missing_imports = True\n"
    (folder / "mypy.ini").write_text(f"[mypy]\nmypy_path = {ROOT}\n{options}")
    done = subprocess.run(
        [sys.executable, "-m", "mypy", "--config-file", "mypy.ini", *paths],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout


def test_every_command_and_path_that_it_names_exists() -> None:
    from hil.cli import COMMANDS

    plugins = {"design", "identify", "tune"}
    named = set(re.findall(r"\bhil (\w+)", " ".join(re.findall(r"`([^`\n]+)`|^(hil .*)$", README, re.M)[0])))
    for text in re.findall(r"^hil (\w+)", README, re.MULTILINE):
        named.add(text)
    assert named <= set(COMMANDS) | plugins
    for path in re.findall(r"\]\(([\w/.]+)\)", README):
        assert (ROOT / path).exists(), path

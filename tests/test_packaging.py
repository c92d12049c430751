"""What is shipped: the wheel holds code, C sources, style sheet and catalogue problems; versions and ranges agree."""

import importlib.metadata
import os
import re
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

import energyopt as eo

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """The wheel of this checkout, built offline with the installed backend."""
    pytest.importorskip("hatchling")
    out = tmp_path_factory.mktemp("dist")
    command = [sys.executable, "-m", "hatchling", "build", "--target", "wheel", "--directory", str(out)]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True)
    return next(out.glob("*.whl"))


def test_the_wheel_holds_code_c_sources_and_problems(wheel):
    names = set(zipfile.ZipFile(wheel).namelist())
    sources = [p for kind in ("*.py", "*.c", "*.h", "*.css") for p in (ROOT / "energyopt").rglob(kind)]
    missing = [str(p.relative_to(ROOT)) for p in sources if p.relative_to(ROOT).as_posix() not in names]
    assert not missing
    problems = [f"energyopt/_problems/{p.name}" for p in (ROOT / "problems").glob("*.toml")]
    assert len(problems) >= 10 and set(problems) <= names
    assert not [name for name in names if name.startswith(("tests/", "problems/")) or "__pycache__" in name]


def test_the_wheel_installs_a_command_and_its_licence(wheel):
    archive = zipfile.ZipFile(wheel)
    folder = f"energyopt-{eo.__version__}.dist-info"
    assert "energyopt = energyopt.__main__:run" in archive.read(f"{folder}/entry_points.txt").decode()
    assert any(name.startswith(folder) and name.endswith("LICENSE") for name in archive.namelist())


def test_problems_are_found_where_only_the_wheel_is(wheel, tmp_path):
    zipfile.ZipFile(wheel).extractall(tmp_path / "site")
    show = "eo.__file__, eo.load_problem('panda_reach').name, io.problems_folder()"
    code = f"import energyopt as eo, energyopt.io as io; print({show})"
    environment = {**os.environ, "PYTHONPATH": str(tmp_path / "site")}
    shown = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, env=environment, check=True, capture_output=True, text=True
    )
    assert shown.stdout.split() == [
        str(tmp_path / "site" / "energyopt" / "__init__.py"),
        "panda_reach",
        str(tmp_path / "site" / "energyopt" / "_problems"),
    ]


def locked(name):
    text = (ROOT / name).read_text()
    return dict(re.findall(r"^([A-Za-z0-9_.-]+)==([^ \n\\]+)", text, flags=re.MULTILINE))


def extra(project, name):
    """Names of what an extra asks for, with that of the project's own extras it names."""
    from packaging.requirements import Requirement

    asked = [Requirement(text) for text in project["optional-dependencies"][name]]
    own = [inner for each in asked if each.name == project["name"] for inner in each.extras]
    return {each.name for each in asked if each.name != project["name"]}.union(*(extra(project, inner) for inner in own))


def test_the_lock_files_name_one_exact_version_with_hashes_for_every_requirement():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    run, dev = locked("requirements.lock"), locked("requirements-dev.lock")
    name_of = lambda requirement: re.match(r"[A-Za-z0-9_.-]+", requirement)[0]
    assert {name_of(r) for r in project["dependencies"]} <= set(run)
    tools = extra(project, "dev")
    assert {"pytest", "distributed", "toppra"} <= tools <= set(dev) and "energyopt" not in dev
    assert run.items() <= dev.items()
    for file in ("requirements.lock", "requirements-dev.lock"):
        entries = re.split(r"\n(?=[A-Za-z0-9])", (ROOT / file).read_text())
        assert all("--hash=sha256:" in entry for entry in entries if "==" in entry.split("\n")[0])


def test_the_ranges_of_the_project_start_at_the_locked_versions():
    from packaging.requirements import Requirement

    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    run = locked("requirements.lock")
    for text in project["dependencies"]:
        requirement = Requirement(text)
        assert requirement.specifier.contains(run[requirement.name]), text
        lowest = next(s.version for s in requirement.specifier if s.operator == ">=")
        assert run[requirement.name].startswith(lowest), text


def test_importing_the_package_loads_neither_simulator_nor_plots():
    code = "import sys, energyopt; print([m for m in ('mujoco', 'matplotlib', 'casadi') if m in sys.modules])"
    shown = subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=True, capture_output=True, text=True)
    assert shown.stdout.strip() == "[]"


def test_planning_loads_neither_simulator_nor_plots():
    code = "import sys, energyopt.planning, energyopt.io; print([m for m in ('mujoco', 'matplotlib') if m in sys.modules])"
    shown = subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=True, capture_output=True, text=True)
    assert shown.stdout.strip() == "[]"


def test_the_installed_version_is_the_packages_own():
    try:
        installed = importlib.metadata.version("energyopt")
    except importlib.metadata.PackageNotFoundError:
        pytest.skip("run from a checkout without installation")
    assert installed == eo.__version__


def test_every_public_name_can_be_imported():
    for name in eo.__all__:
        assert getattr(eo, name) is not None

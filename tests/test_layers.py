"""The layers of the package point one way: a module imports, when it is loaded, only from lower ones."""

import ast
from pathlib import Path

import energyopt

ROOT = Path(energyopt.__file__).parent
LAYERS = (  # lowest first; docs/concepts.md says what each is for
    "clock clusters enduring errors exit_codes messages ordered pool progress readable serving stopping threads versions workers",
    "actuators dynamics",
    "robots",
    "geometry",
    "collision",
    "costs problem problem_values parameterizations",
    "avoidance clearance",
    "optima sampling waypoints plans solvers arguments",
    "limit_checks baselines inverse_kinematics feasibility impossible least_times reach timing",
    "clearance_checks pathfinding",
    "transcription",
    "verification plan_text durations retiming rescaling seeds diversity refinement",
    "search_state",
    "rounds",
    "search",
    "attempts searcher",
    "found fanout detours racing",
    "campaign",
    "planning io",
    "parcels places batch whatif sensitivity",
    "simulation",
    "metrics energy",
    "robust following sweeping sweep_text sequence",
    "validation validation_text",
    "judging",
    "plots plotting report report_energy report_parts report_problem report_scene",
    "workflow batch_files robust_workflow sweep_files",
    "tables",
    "cli_parser cli_commands",
    "cli",
    "__main__",
)


def loaded_imports(tree: ast.Module):
    """Modules of energyopt imported at module level; what a function or TYPE_CHECKING imports does not count."""
    for node in tree.body:
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("energyopt."):
            yield node.module.split(".")[1]


def test_modules_import_only_from_lower_layers():
    height = {name: k for k, layer in enumerate(LAYERS) for name in layer.split()}
    wrong = []
    for path in sorted(ROOT.rglob("*.py")):
        own = path.relative_to(ROOT).with_suffix("").parts[0]
        if own == "__init__" or own.startswith("_problems"):
            continue
        assert own in height, f"{own} has no layer yet: name it in LAYERS and in docs/concepts.md"
        for other in loaded_imports(ast.parse(path.read_text())):
            if other != own and height[other] > height[own]:
                wrong.append(f"{path.relative_to(ROOT)} imports {other}")
    assert not wrong


def test_only_the_simulation_imports_mujoco_and_only_the_plots_matplotlib():
    for path in sorted(ROOT.rglob("*.py")):
        names = {
            alias.name.split(".")[0] if isinstance(node, ast.Import) else (node.module or "").split(".")[0]
            for node in ast.walk(ast.parse(path.read_text()))
            if isinstance(node, ast.Import | ast.ImportFrom)
            for alias in node.names
        }
        place = path.relative_to(ROOT).parts[0].removesuffix(".py")
        assert "mujoco" not in names or place == "simulation", path
        assert "matplotlib" not in names or place in ("plots", "plotting", "report"), path

"""The report page: whole, self-contained, safe whatever the names are, and its numbers are those of the run."""

import re
from dataclasses import replace
from html.parser import HTMLParser

import arms
import numpy as np
import pytest
from figure_plans import around, cycloid_plan, replayed, slider_plan

import energyopt as eo
from energyopt.errors import FileError
from energyopt.plots import look
from energyopt.plots.svg import VARIABLES
from energyopt.report import report_page, write_report

VOID = {"meta", "link", "br", "img", "hr", "input"}
HOSTILE = "</title><script>alert('x')</script>\"&\x07 <img src=x onerror=alert(1)>"


class Reader(HTMLParser):
    """Collects tags, attributes and words, and checks that what is opened is closed."""

    def __init__(self, page):
        super().__init__()
        self.open, self.tags, self.attributes, self.words, self.cells = [], [], [], [], []
        self.feed(page)
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.attributes += attrs
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.tags.append(tag)
        self.attributes += attrs

    def handle_endtag(self, tag):
        assert self.open and self.open[-1] == tag, f"</{tag}> closes <{self.open[-1] if self.open else None}>"
        self.open.pop()

    def handle_data(self, data):
        if self.open and self.open[-1] not in ("style",):
            self.words.append(" ".join(data.split()))

    @property
    def text(self):
        return " ".join(filter(None, self.words))


@pytest.fixture(scope="module")
def panda():
    plan, log = cycloid_plan("panda"), replayed("panda")
    report = eo.validate(plan, log)
    return plan, log, report, report_page(plan, log, report)


def test_the_page_is_well_formed_and_needs_nothing_beside_itself(panda):
    page = panda[3]
    reader = Reader(page)
    assert reader.tags.count("svg") == 3 and not {"script", "link", "img", "iframe", "object", "base"} & set(reader.tags)
    for name, value in reader.attributes:
        assert not name.startswith("on") and name != "src"
        assert name not in ("href", "xlink:href") or value.startswith("#")
    assert "http" not in page and "@import" not in page and "//" not in re.sub(r"<style>.*?</style>", "", page, flags=re.DOTALL)
    assert all(target.startswith("#") for target in re.findall(r"url\(([^)]*)\)", page))


def test_every_id_is_there_once_and_every_reference_finds_its_id(panda):
    page = panda[3]
    ids = re.findall(r'\bid="([^"]*)"', page)
    assert len(ids) == len(set(ids)) > 10
    references = re.findall(r'href="#([^"]*)"', page) + re.findall(r"url\(#([^)]*)\)", page)
    assert references and set(references) <= set(ids)


def test_numbers_of_the_run_stand_on_the_page(panda):
    plan, log, report, page = panda
    text, quintic = Reader(page).text, report.baselines["quintic"]
    assert f"Objective J {report.objective:.5g}" in text
    assert f"{report.plan_metrics.mechanical_abs_J:.4g} J" in text
    way = "below" if quintic.saving_percent >= 0 else "above"
    assert f"{abs(quintic.saving_percent):.1f} % {way} the quintic of the same duration" in text
    assert f"{log.tracking_max:.2g} rad" in text and f"{report.energy_gap_percent:+.3g} %" in text
    for other in report.baselines.values():
        assert f"{other.objective:.5g}" in text
    for check in report.checks:
        assert check.name in text
    for name, (joint, time) in report.violations.worst.items():
        words = name.removesuffix("_percent").replace("_", " ")
        assert re.search(rf"{words} \S.*?{joint or '–'} {time:.3f} s", text)
    assert all(joint in text for joint in plan.problem.robot.joint_names)


def test_a_baseline_that_breaks_limits_is_marked_beside_its_saving():
    """A pendulum of 1 rad in 1 s: the quintic peaks at 1.875 rad/s, the trapezoid at 1.5, with a limit of 1.7 between."""
    robot = arms.pendulum().with_limits(velocity=np.array([1.7]))
    problem = eo.Problem(robot, [0.0], [1.0], 1.0, name="fast")
    plan = around(problem, eo.baseline(problem, "trapezoidal"))
    text = Reader(report_page(plan, None, eo.validate(plan))).text
    assert "the quintic of the same duration, which breaks its limits" in text
    assert re.search(r"quintic [\d.]+ −?[\d.]+ % [\d.]+ −?[\d.]+ % 1\.8[78] broken: velocity", text)
    assert re.search(r"trapezoidal [\d.]+ 0.0 % [\d.]+ 0.0 % 1.5 held", text)


def test_names_cannot_put_markup_into_the_page(panda):
    plan, log, report, _ = panda
    problem = replace(plan.problem, name=HOSTILE, robot=replace(plan.problem.robot, name=HOSTILE))
    evil = replace(plan, problem=problem, message=HOSTILE, notes=(HOSTILE,), options={HOSTILE: HOSTILE})
    log = replace(log, settings={HOSTILE: HOSTILE})
    for status in (eo.Status.SOLVED, eo.Status.INFEASIBLE):
        page = report_page(replace(evil, status=status), log, report)
        reader = Reader(page)
        assert "script" not in reader.tags and "img" not in reader.tags
        assert "alert('x')" in reader.text and "\x07" not in page


def test_joint_names_cannot_put_markup_into_the_page():
    import urdf_factory as factory

    text = factory.pendulum().replace('name="joint1"', 'name="&lt;b&gt;&amp;$j$"')
    assert "&lt;b&gt;" in text
    robot = arms.from_urdf(text)
    assert robot.joint_names == ("<b>&$j$",)
    problem = eo.Problem(robot, [0.0], [0.3], 1.0)
    plan = around(problem, eo.baseline(problem))
    reader = Reader(report_page(plan, None, eo.validate(plan)))
    assert reader.tags.count("b") == 1 and "<b>&$j$" in reader.text


def test_a_plan_that_failed_says_so_first():
    """2 rad in 0.3 s breaks the velocity limit."""
    robot = arms.pendulum().with_limits(velocity=np.array([3.0]))
    problem = eo.Problem(robot, [0.0], [2.0], 0.3, name="too fast")
    plan = around(problem, eo.baseline(problem), eo.Status.LIMITS_VIOLATED, "the dense check found a limit exceeded")
    page = report_page(plan, None, eo.validate(plan))
    text = Reader(page).text
    assert 'class="verdict bad"' in page and text.index("LIMITS_VIOLATED") < text.index("Objective J")
    assert "This motion is not a solution" in text and "There is no replay" in text
    assert re.search(r"velocity −\d+\.\d\d % joint1 0\.150 s .*? for all t FAILED", text)


def test_where_limits_hold_depends_on_the_kind_of_motion():
    """Extrema of splines are exact; those of sinusoids are found from samples."""
    spline = slider_plan(arms.sliders(1))
    wave = replace(spline, trajectory=eo.baseline(spline.problem, "cycloid"))
    assert "for all t" in report_page(spline, None, eo.validate(spline))
    page = report_page(wave, None, eo.validate(wave))
    assert "for all t" not in page and "at dense samples and the extrema between" in page


def test_a_cartesian_goal_waypoints_friction_and_end_velocities_are_listed():
    robot = replace(arms.pendulum(), dynamics=replace(arms.pendulum().dynamics, viscous_friction=np.array([0.25])))
    tip = robot.placement(robot.tool_frame, np.array([0.5])).translation
    problem = eo.Problem(
        robot, [0.0], eo.FramePose(robot.tool_frame, tip), 2.0, start_velocity=0.1, waypoints=[([0.2], 0.7), [0.4]]
    )
    motion = eo.baseline(problem, goal=np.array([0.5]))
    text = Reader(report_page(plan := around(problem, motion), None, eo.validate(plan))).text
    for words in (
        "in any orientation",
        "Waypoint 1, at 0.7 s 0.2",
        "at a time left free 0.4",
        "Start velocity 0.1",
        "Viscous friction 0.25 N·m·s/rad",
    ):
        assert words in text
    assert re.search(r"goal – \S+ 2\.000 s", text)


def test_the_page_follows_light_and_dark():
    """Every colour of the figures is a variable that the style sheet redefines for dark screens and for paper."""
    plan = slider_plan(arms.sliders(1))
    page = report_page(plan, None, eo.validate(plan))
    style = page[page.index("<style>") : page.index("</style>")]
    dark, printed = (
        style[style.index("prefers-color-scheme: dark") : style.index("box-sizing")],
        style[style.index("@media print") :],
    )
    for colour, name in VARIABLES.items():
        assert f"--figure-{name}:" in dark and f"--figure-{name}: {colour};" in printed
    figures = page[page.index("<svg") :]
    assert not re.findall(r"(?<!,)#[0-9a-f]{6}\b", figures.replace(look.BASELINE_COLOURS[0], "")), "a colour that is no variable"


def test_the_page_of_fourteen_joints_stays_below_a_megabyte_and_is_the_same_twice(tmp_path):
    plan, log = cycloid_plan("baxter"), replayed("baxter")
    report = eo.validate(plan, log)
    for name in ("one.html", "two.html"):
        write_report(plan, log, report, tmp_path / name)
    one, two = ((tmp_path / name).read_bytes() for name in ("one.html", "two.html"))
    assert one == two and len(one) < 1_000_000


def test_a_place_that_cannot_be_written_is_one_line(panda, tmp_path):
    plan, log, report, _ = panda
    with pytest.raises(FileError, match="cannot be written"):
        write_report(plan, log, report, tmp_path / "missing" / "report.html")
    assert list(tmp_path.iterdir()) == []

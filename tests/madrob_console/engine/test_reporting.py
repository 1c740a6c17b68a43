"""Reports and exports that an engine makes by itself."""

from __future__ import annotations

import asyncio
import json
import os
import re
import shutil
import signal
import threading
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from unittest.mock import AsyncMock
from zipfile import ZipFile

import pytest

from madrob_console.archive.pictures import pictures_of
from madrob_console.archive.scored import score_opened
from madrob_console.cli.main import main
from madrob_console.common.errors import MadrobError
from madrob_console.common.version import software_version
from madrob_console.engine.ipc import server
from madrob_console.engine.ipc.server import AGAIN, LogOnce
from madrob_console.engine.ipc.service import FallenThreads
from madrob_console.engine.requests import ExportTeam, Role
from madrob_console.engine.runtime.engine_thread import LocalEngine
from madrob_console.engine.runtime.reports import Reporting, WantedPages
from madrob_console.engine.snapshot import ExportView, Snapshot
from madrob_console.pages.related_runs import RelatedRuns
from madrob_console.pages.report import report_html
from madrob_console.referee.acts import (
    Abort,
    Act,
    AddNote,
    ConfirmPose,
    Correct,
    Finalise,
    Reissue,
    Rule,
    SetUp,
    Start,
    Void,
    ZeroHandle,
)
from madrob_console.referee.checks import blocking
from madrob_console.referee.records import TeamWord
from madrob_console.testbeds.simulated import Scenario
from scoring.protocol import Step
from tests.madrob_console.archive.frames import film
from tests.madrob_console.engine.drive import Drive, document, make_setup
from tests.madrob_console.engine.reporting import no_reporting, reporting_on, told_of
from tests.madrob_console.engine.served import Served, simulated
from tests.madrob_console.engine_process import EngineProcess
from tests.madrob_console.pages.competition_runs import put_recorded
from tests.madrob_console.recorded_runs import completed
from tests.madrob_console.run_folders import summary, write
from tests.watching import alive, children_of, until

MINUTES = 180.0
"""For what takes many processes of low priority, s."""


def test_every_result_that_is_on_disk_is_told(tmp_path: Path) -> None:
    told: list[tuple[str, int]] = []

    def tell(folder: Path) -> None:
        told.append((folder.name[:28], document(folder)["issue"]))

    drive = Drive(tmp_path, Scenario.NO_TOUCH)
    drive.engine.make_reports = tell
    drive.whole_run(make_setup(timeout=1.0))
    drive.act(
        Rule(Step.TOUCH, confirmed=True, reason="seen"),
        Finalise(TeamWord.ACKNOWLEDGED, "R. Eferee"),
        Reissue("the team is right"),
        Rule(Step.TOUCH, confirmed=False, reason="seen again"),
    )
    drive.start(make_setup(run_number=2))
    drive.wait(0.5)
    left = drive.cut_off_copy(tmp_path / "of a machine that failed")
    drive.engine.close()
    later = Drive(tmp_path / "of a machine that failed")
    later.engine.make_reports = tell
    assert later.open(left) is None
    later.engine.close()
    first, cut_off = (f"subject_003_cond_001_run_00{number}" for number in (1, 2))
    assert told == [*((first, issue) for issue in (1, 1, 1, 2, 2)), *[(cut_off, 1)] * 2]


def test_what_an_engine_that_ends_refuses_is_not_asked_again_and_again(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    reporting = Reporting(("none",), tmp_path)
    for worker in reporting.workers:
        worker.end()
    reporting.repair()
    assert "the engine has ended" in str(reporting.problem)
    assert caplog.records == []


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Of a run among the results."""
    return Path(shutil.copytree(completed(), tmp_path / "runs" / completed().name))


def publishing(site: Path, results: Path) -> WantedPages:
    return WantedPages(publish=(str(site), f"--results={results}", "--practice"))


@pytest.mark.machine
def test_the_frames_of_instants_stay_in_the_folder_of_the_run(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    elsewhere, frames = tmp_path / "temporary", folder / "frames"
    elsewhere.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(elsewhere))
    with reporting_on(folder.parent) as reporting:

        def ask(at: float) -> str:
            return reporting.frames(folder, at).result(60.0)

        with pytest.raises(MadrobError, match="no camera was recorded beside it"):
            ask(5.0)
        assert not frames.exists()
        film(folder, "/camera/front", "/camera/side")
        with pytest.raises(MadrobError, match="no frame within 1 s"):
            ask(900.0)
        assert [ask(at) for at in (5.0, 6.5)] == [str(frames)] * 2
    names = [re.sub(r"_\d+_ms_(later|earlier)[.]", ".", path.name) for path in frames.iterdir()]
    assert sorted(names) == [
        f"01_at_{at}_s_camera_{camera}.jpg"
        for at in ("5_000", "6_500")
        for camera in ("front", "side")
    ]
    assert not list(elsewhere.iterdir())


@pytest.mark.machine
def test_report_and_pages_follow_every_result_as_madrob_report_makes_them(tmp_path: Path) -> None:
    results, site = tmp_path / "runs", tmp_path / "site"
    drive, team = Drive(results, Scenario.NO_TOUCH), site / "teams/003.html"
    with reporting_on(results, publishing(site, results)) as reporting:
        drive.engine.make_reports = reporting.report

        def published() -> str:
            assert (reporting.wait(60.0), reporting.problem) == (True, None)
            return team.read_text()

        drive.whole_run(make_setup(timeout=1.0))
        before = published()
        assert ("timeout" in before, "PROTESTED" in before) == (True, False)
        assert list(site.glob("runs/*/report.html"))  # it was made before
        film(drive.folder, "/camera/front")
        drive.act(Finalise(TeamWord.PROTESTED, "R. Eferee"))
        drive.engine.close()
        assert "PROTESTED" in published()
    page, scored = (drive.folder / "report.html").read_text(), score_opened(drive.folder)
    place, seen = RelatedRuns().place_of(drive.folder, scored), pictures_of(drive.folder, scored)
    assert page == report_html(scored, software_version(), place, seen)
    assert "PROTESTED" in page
    assert page.count("<img ") == len(seen) > 0


@pytest.mark.machine
@pytest.mark.parametrize(
    ("in_the_way", "words"),
    [
        ("runs/RUN/report.html", "no report of RUN: "),
        ("site/teams/003.html", "the pages in SITE are not up to date: SITE: not written"),
    ],
)
def test_what_the_disk_refuses_is_a_fault_until_it_is_made(
    in_the_way: str, words: str, folder: Path, tmp_path: Path
) -> None:
    site, page = tmp_path / "site", tmp_path / in_the_way.replace("RUN", folder.name)
    with reporting_on(folder.parent, publishing(site, folder.parent)) as reporting:
        reporting.publish()
        assert reporting.wait(60.0)
        page.unlink(missing_ok=True)
        page.mkdir()
        reporting.report(folder)
        told = told_of(reporting, words.replace("RUN", folder.name).replace("SITE", str(site)))
        assert "it is tried again" in told
        page.rmdir()
        until(lambda: reporting.problem is None and page.is_file())


@pytest.mark.machine
def test_what_cannot_ever_be_made_is_told_and_not_tried_again(tmp_path: Path) -> None:
    write(tmp_path, summary(3))
    wanted = WantedPages(
        publish=(str(tmp_path), f"--results={tmp_path}"), options=(f"--results={tmp_path}",)
    )
    with reporting_on(tmp_path, wanted) as reporting:
        reporting.publish()
        told_of(reporting, "holds other things; name an empty folder")
        reporting.report(tmp_path / "deleted")
        reporting.export(4)
        assert reporting.exported == ExportView(4)
        assert "tried again" not in told_of(reporting, "no report of deleted")
        assert reporting.wait(60.0)
        assert reporting.exported.path == ""
        assert "subject 4 has no runs" in reporting.exported.problem


@pytest.mark.machine
def test_what_an_engine_left_unmade_the_next_one_makes(folder: Path, tmp_path: Path) -> None:
    """A crash leaves a run without a report, another one with that of an earlier result."""
    site, report = tmp_path / "site", folder.parent / completed(2).name / "report.html"
    shutil.copytree(completed(2), report.parent)
    assert main(["report", str(report.parent)]) == 0
    old = re.sub('(name="journal" content=")', r"\g<1>9", report.read_text())
    report.write_text(old)
    with reporting_on(folder.parent, publishing(site, folder.parent)) as reporting:
        reporting.repair()
        until((folder / "report.html").is_file)
        until(lambda: report.read_text() != old)
        until((site / "index.html").is_file)
        assert (reporting.wait(60.0), reporting.problem) == (True, None)


@pytest.mark.machine
def test_a_folder_on_a_stick_runs_no_program(folder: Path, tmp_path: Path) -> None:
    """What an engine of an earlier version read as orders, and worse."""
    ran, queue = tmp_path / "ran", folder.parent / ".madrob_queue"
    queue.mkdir()
    for name, kind, arguments in (
        ("1.json", "command", [str(folder), "touch", str(ran)]),
        ("2.json", "export", [f"--output={ran}", "--subject=3", "--practice"]),
    ):
        chore = {"name": name, "kind": kind, "arguments": arguments}
        (queue / name).write_text(json.dumps(chore))
    os.mkfifo(queue / "3.json")
    (queue / "4.json").mkdir()
    before = sorted(queue.rglob("*"))
    with EngineProcess(folder.parent, "no-touch"):
        until((folder / "report.html").is_file, MINUTES)  # it works off what is to be made
    assert not ran.exists()
    assert sorted(queue.rglob("*")) == before


@pytest.mark.machine
def test_a_run_cuts_a_chore_short_which_is_done_again_after_it(folder: Path) -> None:
    """Killed at any moment, by a run or for want of memory: nothing half written stays."""
    before, report = {path.name for path in folder.iterdir()}, folder / "report.html"
    with reporting_on(folder.parent) as reporting:

        def begun() -> int:
            reporting.report(folder)
            return until(lambda: reporting.workers[0].pid) or 0

        for end in (0.0, 0.4, 0.8):
            pid = begun()
            threading.Event().wait(end)  # some moment
            reporting.hold(held=True)
            until(lambda pid=pid: not alive(pid))  # type: ignore[misc]
            assert reporting.problem is None
            assert {path.name for path in folder.iterdir()} - before <= {report.name}
            reporting.hold(held=False)
        os.kill(begun(), signal.SIGKILL)
        told = "no reports, pages and zips: it was ended by SIGKILL; it is tried again"
        until(lambda: reporting.problem == told)
        until(lambda: reporting.problem is None and report.is_file())
        assert "</html>" in report.read_text()


@pytest.mark.machine
@pytest.mark.slow
@pytest.mark.parametrize("more", [[], ["--no-report"]])
def test_madrob_run_leaves_report_and_pages_as_it_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], more: list[str]
) -> None:
    settings = tmp_path / "madrob.toml"
    settings.write_text(f'[results]\nfolder = "{tmp_path}/runs"\npublish = "{tmp_path}/site"\n')
    flags = ["--testbed", "simulated", "--speed=0", "--countdown=1", "--timeout=1"]
    assert main(["run", *flags, *more, f"--settings={settings}"]) == 3
    folder = Path(capsys.readouterr().out.splitlines()[-1].removeprefix("run folder: "))
    assert (folder / "report.html").exists() is not bool(more)
    assert "No run counts yet." in (tmp_path / "site/index.html").read_text()  # practice


@pytest.mark.machine
def test_a_console_has_a_team_packed_and_every_screen_sees_where_the_zip_is(tmp_path: Path) -> None:
    wanted, results = summary(3), tmp_path / "runs"
    for run in (wanted, summary(3, hour=1, competition="Spring Cup")):
        write(results, run)
    with (
        reporting_on(results, WantedPages(options=[f"--results={results}"])) as reporting,
        closing(Served(tmp_path, reporting=reporting)) as served,
        closing(served.attach()) as console,
        closing(served.attach(Role.WATCH)) as watcher,
    ):
        assert watcher.send_request(ExportTeam(3)) == "this screen only watches"
        assert console.send_request(ExportTeam(3, competition="Autumn Cup")) is None
        until(lambda: (view := watcher.snapshot().export) is not None and view.path)
        made = watcher.snapshot().export
    assert made is not None
    assert (made.subject, made.problem) == (3, "")
    assert Path(made.path).parent == results / "exports"
    names = ZipFile(made.path).namelist()
    assert {name.partition("/")[0] for name in names if "/" in name} == {wanted.folder}


def other_runs(report: Path) -> list[str]:
    """Of the team, in the words of a report."""
    text = report.read_text()
    found = re.search('<section id="runs">.*?</section>', text, re.DOTALL)
    compared = re.findall("(?:condition is|the next is) (run [0-9]+)[.]", text)
    return compared + re.findall("run [0-9]+(?=<| \\()", found[0] if found else "")


@pytest.mark.machine
def test_after_a_correction_reports_and_site_are_true_or_what_cannot_be_is_named(
    tmp_path: Path,
) -> None:
    results, site = tmp_path / "runs", tmp_path / "site"
    first, second = put_recorded(results)
    page, drive = first / "report.html", Drive(results)
    assert main(["report", str(results)]) == 0
    with reporting_on(results, publishing(site, results)) as reporting:
        drive.engine.make_reports = reporting.report

        def told_after(act: Act) -> list[list[str]]:
            drive.act(act)
            assert (reporting.wait(60.0), reporting.problem) == (True, None)
            (published,) = site.glob(f"runs/{first.name}_*/report.html")
            return [other_runs(each) for each in (page, published)]

        assert drive.open(second) is None
        assert told_after(Correct(4, make_setup().condition, "typed wrongly")) == [[], []]
        drive.take_back()
        assert told_after(AddNote("it was right")) == [["run 2", "run 2"]] * 2
        before = page.stat().st_mtime_ns
        assert told_after(AddNote("nothing new")) == [["run 2", "run 2"]] * 2
        assert page.stat().st_mtime_ns == before
        assert told_after(Void("the wrong door")) == [["run 2"]] * 2
        assert "run 2</a> (VOID: " in page.read_text()
        drive.engine.close()
        for recording in first.glob("*.mcap"):
            recording.unlink()
        second.rename(tmp_path / "away")
        reporting.report(first)
        words = f"results or reports in {results} are not up to date: "
        assert first.name in told_of(reporting, words)


@pytest.mark.machine
@pytest.mark.slow
def test_an_engine_makes_reports_when_no_run_goes_on_even_as_its_last_deed(tmp_path: Path) -> None:
    setup = make_setup(countdown=1.0)
    with EngineProcess(tmp_path, "no-touch") as engine:
        engine.start(setup)

        def making() -> list[str]:
            """What makes reports, zombies as well."""
            lines = children_of(engine.process.pid).values()
            return [line for line in lines if not line or "cli.chore_worker" in line]

        begun = engine.snapshot().time

        def goes_on(shown: Snapshot) -> bool:
            assert making() == []
            return shown.time > begun + 2.0

        engine.wait_for(goes_on)
        engine.act(Abort("enough"))
        engine.result()
        until(lambda: any(making()))
        engine.act(SetUp(replace(setup, run_number=2)), ZeroHandle(), ConfirmPose())
        engine.wait_for(lambda s: not blocking(s.checks))
        engine.act(Start())  # a process that goes on ends for it, and no zombie stays
        until(lambda: not making())
        assert engine.snapshot().run.active
    until(lambda: len(list(tmp_path.rglob("report.html"))) == 2)
    assert all("</html>" in path.read_text() for path in tmp_path.rglob("report.html"))
    assert not [p for p in tmp_path.rglob(".*") if p.parent != tmp_path]


def test_each_kind_of_trouble_is_a_line_and_is_said_again_only_after_a_while(
    capsys: pytest.CaptureFixture[str],
) -> None:
    now = [1000.0]
    log = LogOnce(lambda: now[0])

    def said(what: str, *errors: Exception) -> list[str]:
        for error in errors:
            log.log_trouble(what, error)
        return capsys.readouterr().err.splitlines()

    many = OSError(24, "Too many open files")
    line = "madrob: new screens must wait ([Errno 24] Too many open files)"
    assert said("new screens must wait", *[many] * 1000) == [line]
    assert said("a screen was let go", MemoryError()) == [
        "madrob: a screen was let go (MemoryError)"
    ]
    now[0] += AGAIN
    assert said("new screens must wait", many) == [line]
    raw = said("\x1b[2Jscreen\n", ValueError("\x1b]0;owned\x07"))
    assert raw == ["madrob: screen  ()"]  # nothing reaches a terminal raw
    for number in range(1000):
        log.log_trouble(f"screen {number}")
    assert len(capsys.readouterr().err.splitlines()) <= 50


def test_a_loop_says_its_troubles_in_a_line_and_begins_again_what_must_go_on(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(server, "_RETRY_PAUSE", 0.0)
    work, log = AsyncMock(side_effect=[MemoryError("lost")] * 5 + [None]), LogOnce()

    async def forget_a_task() -> None:
        asyncio.get_running_loop().set_exception_handler(log.of_loop)
        await asyncio.wait([asyncio.create_task(work())])

    asyncio.run(forget_a_task())
    asyncio.run(log.lasting(work))
    assert work.await_count == 6
    assert capsys.readouterr().err.splitlines() == [
        "madrob: Task exception was never retrieved (lost)",
        "madrob: screens had to wait (lost)",
    ]


@pytest.mark.machine
def test_a_thread_that_falls_is_a_fault_on_the_screens(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail() -> None:
        raise ValueError("\x1b[2Ja bug")

    fallen = FallenThreads()
    monkeypatch.setattr(threading, "excepthook", fallen.note)
    local = LocalEngine(simulated(tmp_path), no_reporting(tmp_path), lambda: fallen.problem)
    with closing(local):
        assert not any("has ended" in fault for fault in local.snapshot().faults)
        thread = threading.Thread(target=fail, name="intake")
        thread.start()
        thread.join()
        words = "a part of the engine has ended (intake: a bug): start it again after the run"
        until(lambda: words in local.snapshot().faults)
    assert "ValueError" in capsys.readouterr().err

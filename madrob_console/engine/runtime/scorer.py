"""Scores the runs of an engine."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from functools import partial
from pathlib import Path

import msgspec

from madrob_console.archive.result_files import result_files
from madrob_console.archive.scored import Scored, assess_recording, open_run
from madrob_console.common.plain_files import naming_folder
from madrob_console.engine.core.scored_run import (
    EarlierRun,
    PastRun,
    RenderedResult,
    ScoringRequest,
)
from madrob_console.engine.curves import curves_of
from madrob_console.engine.runtime.disk import DiskJobs
from scoring.assessment import Assessment
from scoring.kinematics import load_filters


def rendered(scored: Scored, assessment: Assessment, files: Mapping[str, bytes]) -> RenderedResult:
    """From a scored run, its samples and the result's files, if any were wanted."""
    return RenderedResult(
        record=scored.record,
        run=scored.run,
        result=scored.result,
        past=PastRun.of(scored.run, assessment, scored.result.stop),
        files={name: memoryview(content) for name, content in files.items()},
        curves=memoryview(msgspec.msgpack.encode(curves_of(scored.result, scored.rows))),
    )


_MOST_CACHED = 2
"""Samples are cached for two runs: the current one, and one that is read to be opened."""


class RunScorer:
    """Scores runs one after the other; caches the samples of the last ones for corrections."""

    def __init__(self) -> None:
        self._cache: dict[Path, Assessment] = {}

    def read(self, folder: Path) -> EarlierRun:
        opened = open_run(folder)
        recorded, data = opened.recorded, opened.assessment
        scored = rendered(Scored.of(recorded.record, recorded.run, data), data, {})
        self._put_in_cache(folder, data)
        return EarlierRun(folder, recorded.entries, scored, opened.out_of_date)

    def score(self, wanted: ScoringRequest) -> RenderedResult:
        """Score a run from the samples it comes with, else from those cached or recorded."""
        run, folder, record = wanted.run, wanted.folder, wanted.record.corrected(wanted.run)
        data = wanted.assessment or self._cache.pop(folder, None)
        inside = wanted.inside or folder
        with naming_folder(folder, inside):
            if data is None or data.condition != record.setup.condition:
                data = assess_recording(inside, record, run, stored=wanted.stored)
            scored = Scored.of(record, run, data, wanted.missing)
            files = result_files(folder, scored, inside) if wanted.files else {}
        result = rendered(scored, data, files)
        self._put_in_cache(folder, data)  # not after an error
        return result

    def _put_in_cache(self, folder: Path, data: Assessment) -> None:
        others = [entry for entry in self._cache.items() if entry[0] != folder]
        self._cache = dict([*others, (folder, data)][-_MOST_CACHED:])


class Scorer:
    """Makes the results of one run after the other: this one at once, where it is asked.

    Only `score` blocks.
    """

    def __init__(self) -> None:
        self._runs = RunScorer()

    def problem(self, place: str) -> str | None:
        """Why a result is missing, or that it is retried; None = all well.

        `place` says where its run is meanwhile.
        """
        return None

    @property
    def hopeless(self) -> bool:
        """Whether several tries failed: the next run need not wait for the result."""
        return False

    def warm(self) -> None:
        """Get ready in the background, so that the first result is not delayed."""
        threading.Thread(target=load_filters, name="filters", daemon=True).start()

    def read(self, folder: Path, _deadline: float = math.inf) -> Future[EarlierRun]:
        """Read an earlier run; not begun after the deadline, monotonic s. From any thread."""
        return DiskJobs().submit_job(partial(self._runs.read, folder))

    def score(self, wanted: ScoringRequest, done: Callable[[RenderedResult], None]) -> None:
        """Score the current run; replaces an earlier request.

        `done` gets its result in the thread that calls `deliver`.
        """
        done(self._runs.score(wanted))

    def forget(self) -> None:
        """The requested result is not wanted any more."""

    def deliver(self) -> None:
        """Hand over the result that came since."""

    def wait_until_idle(self, limit: float) -> bool:
        """Wait `limit` s at most; returns whether the result is there."""
        return True

"""Background tasks on workers, shown with progress and a cancel button."""

from __future__ import annotations

from concurrent.futures import Future

from wafer_viewer.compute.compute_client import Compute
from wafer_viewer.compute.watched_tasks import Answer, Args, WatchedTask
from wafer_viewer.session.core.command_queue import CommandQueue
from wafer_viewer.session.core.notifications import Notifications


class BackgroundWork:
    """Runner of titled tasks on the workers. Use on the session's thread only."""

    def __init__(self, desk: CommandQueue, notices: Notifications, compute: Compute) -> None:
        self._desk, self._notices, self._compute = desk, notices, compute

    def run(self, title: str, task: WatchedTask[*Args, Answer], *args: *Args) -> Future[Answer]:
        """Run a task that a person can cancel."""
        work = ""
        work = self._notices.begin(title, lambda: self._compute.cancel(work))
        done = self._compute.run(work, task, *args)
        done.add_done_callback(lambda _: self._desk.note(self._notices.end, work))
        return done

"""A sink that keeps what a dataset would keep."""

from __future__ import annotations


class Ledger:
    """Fulfils ScanSink: keeps the frames that count, as the dataset's writer does."""

    def __init__(self):
        self.kept, self.open = {}, {}
        self.missed_why, self.faults, self.summaries = {}, [], []

    def pass_begun(self, number, leg):
        self.open = {}

    def frame(self, frame):
        self.open[frame.shot] = frame

    def missed(self, shot, pulse_count, why):
        self.open.pop(shot, None)
        self.missed_why.setdefault(shot, []).append(why)

    def repaired(self, shot):
        pass

    def pass_ended(self, number, summary):
        self.summaries.append(summary)
        self.kept |= self.open
        self.open = {}

    def fault(self, what):
        self.faults.append(what)

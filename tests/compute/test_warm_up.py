"""Which worker compiles what: two share what the first tasks need, all have the rest afterwards."""

from __future__ import annotations

from concurrent.futures import Future

from wafer_viewer.compute.compute_host import Host
from wafer_viewer.compute.messages import ComputeWarm, WarmUp


class Workers:
    """A client whose workers do what they are told when they are told."""

    def __init__(self, *addresses):
        self.addresses, self.submitted = addresses, []

    def subscribe_topic(self, topic, handler):
        pass

    def submit(self, work, *, workers, pure):
        self.submitted.append((work, *workers, Future()))
        return self.submitted[-1][-1]

    def asked(self):
        return [(work, worker) for work, worker, _ in self.submitted]


class Told(list):
    tell = list.append


WARM_UP = WarmUp(first=print, beside=repr, complete=str)


def warming(*addresses):
    workers, told = Workers(*addresses), Told()
    host = Host(workers, told, WARM_UP)
    host._warm_up(list(addresses))
    return workers, told


def test_a_second_worker_helps_and_fields_begin_when_the_first_is_done():
    workers, told = warming("a", "b", "c")
    assert workers.asked() == [(print, "a"), (repr, "b")]
    assert not told
    workers.submitted[0][-1].set_result(None)
    assert told == [ComputeWarm()]
    assert workers.asked()[2:] == [(str, "b"), (str, "c"), (str, "a")]


def test_a_single_worker_compiles_all_by_itself():
    workers, told = warming("a")
    workers.submitted[0][-1].set_result(None)
    assert workers.asked() == [(print, "a"), (str, "a")]
    assert told == [ComputeWarm()]

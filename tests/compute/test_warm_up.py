"""Which worker loads what: one what the first tasks need, all the rest afterwards."""

from __future__ import annotations

import os
import subprocess
import sys
from concurrent.futures import Future

import pytest

from wafer_viewer.compute.compute_host import Host
from wafer_viewer.compute.messages import ComputeWarm, WarmUp
from wafer_viewer.compute.worker_environment import FORKS, WORKER_ENVIRONMENT
from wafer_viewer.session.surface import kernel_build


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


WARM_UP = WarmUp(compile=repr, first=print, complete=str)


def warming(*addresses):
    workers, told = Workers(*addresses), Told()
    host = Host(workers, told, WARM_UP)
    host._warm_up(list(addresses))
    return workers, told


def test_fields_begin_when_one_worker_is_warm():
    workers, told = warming("a", "b", "c")
    assert workers.asked() == [(print, "a")]
    assert not told
    workers.submitted[0][-1].set_result(None)
    assert told == [ComputeWarm()]
    assert workers.asked()[1:] == [(str, "b"), (str, "c"), (str, "a")]


LOADED = f"""
import os, sys
import {kernel_build.WARM_UP.loaded}
from numba.core.dispatcher import Dispatcher

modules = [module for name, module in sys.modules.items() if name.startswith("wafer_viewer.")]
kernels = [kernel for module in modules for kernel in vars(module).values() if isinstance(kernel, Dispatcher)]
print(len(os.listdir("/proc/self/task")), sum(bool(kernel.overloads) for kernel in kernels))
"""


@pytest.mark.campaign
@pytest.mark.skipif(not FORKS, reason="workers begin with nothing here")
def test_what_workers_are_forks_of_has_the_kernels_and_no_thread_that_they_would_lack():
    kernel_build.compile_surface_kernels()
    environment = os.environ | {name: str(value) for name, value in WORKER_ENVIRONMENT.items()}
    done = subprocess.run([sys.executable, "-c", LOADED], env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    threads, kernels = map(int, done.stdout.split())
    assert threads == 1
    assert kernels > 20

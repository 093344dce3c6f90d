"""A cluster of separate processes, as on several machines: scheduler, workers and command line share only files."""

from __future__ import annotations

import os
import shlex
import shutil
import signal
import socket
import ssl
import subprocess
import sys
import time
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

import numpy as np
import psutil
import pytest

from tests.support.command_line import viewer
from tests.support.datasets import worker_tasks
from tests.support.paths import ROOT
from wafer_viewer.compute.crews import crew_for
from wafer_viewer.compute.dask_cluster import client_of
from wafer_viewer.model.errors import ComputeError
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.dataset.stack_import import import_dataset

pytestmark = pytest.mark.slow

SHAPE, COLS, N_FRAMES, OVERLAP = (400, 500), 4, 16, 0.2
MEMORY_BYTES = 700 << 20


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    """Eight fields of one rough slope, in focus at one frame after the other."""
    import tifffile

    folder = tmp_path_factory.mktemp("frames")
    noise = np.random.default_rng(1)
    step_rows, step_cols = (round(n * (1 - OVERLAP)) for n in SHAPE)
    shape = SHAPE[0] + step_rows, SHAPE[1] + (COLS - 1) * step_cols
    relief = noise.normal(0, 40, shape)
    depth = np.add.outer(np.linspace(5, 6, shape[0]), np.linspace(0, 4, shape[1]))
    for row in range(2):
        for col in range(COLS):
            part = np.s_[row * step_rows :, col * step_cols :]
            seen, at = (a[part][: SHAPE[0], : SHAPE[1]] for a in (relief, depth))
            for k in range(N_FRAMES):
                grey = 128 + seen * np.exp(-((k - at) ** 2) / 4) + noise.normal(0, 1, SHAPE)
                tifffile.imwrite(folder / f"r{row}_c{col}_k{k}.tif", grey.clip(0, 255).astype(np.uint8))
    out = tmp_path_factory.mktemp("data") / "scan.wafer"
    import_dataset((folder,), out, 1.0, 0.5, "r{row}_c{col}_k{k}.tif", OVERLAP)
    return out


@pytest.fixture
def fresh(dataset, tmp_path):
    """The dataset without results."""
    return shutil.copytree(dataset, tmp_path / "fresh.wafer", ignore=shutil.ignore_patterns("results", "lock"))


@pytest.fixture(scope="module")
def alone(dataset):
    """What one process makes of it."""
    done = viewer("stitch", dataset, "--workers", "1")
    assert done.returncode == 0, done.stderr
    return Dataset.open(dataset)


@pytest.fixture(scope="module")
def trust(tmp_path_factory):
    return trusted(tmp_path_factory.mktemp("cluster"))


def trusted(folder):
    """A folder of certificates."""
    done = viewer("cluster", folder / "files", "--host", "127.0.0.1")
    assert done.returncode == 0, done.stderr
    (folder / "files" / "lines.txt").write_text(done.stdout.replace("\\\n", ""))
    return folder / "files"


def line_for(trust, part, *, port):
    """The words that the command told us to run in the folder of certificates."""
    lines = (trust / "lines.txt").read_text().splitlines()
    reported = next(line for line in lines if f" dask {part}" in line)
    folder, words = reported.split(" && DASK_CONFIG=. ")
    assert folder.split() == ["cd", str(trust)]
    return shlex.split(words.replace(":8786", f":{port}"))


def started(*words, trust=None, cwd=None, path=ROOT):
    environment = {**os.environ, "PYTHONPATH": str(path)} | ({"DASK_CONFIG": str(trust)} if trust else {})
    command = [sys.executable, "-m", *map(str, words)]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    return subprocess.Popen(command, env=environment, cwd=cwd, start_new_session=True, **pipes)


def process(*words, trust=None):
    running = started("wafer_viewer", *words, trust=trust)
    out, err = running.communicate(timeout=240)
    return subprocess.CompletedProcess(words, running.returncode, out, err)


class Machines:
    """A scheduler and workers, each a process of its own, started in the folder of certificates as a person does."""

    def __init__(self, trust, until_end):
        self.trust, self._until_end, self.processes = trust, until_end, []
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.port = free.getsockname()[1]
        self.scheduler = self._start("Scheduler at", "scheduler", "--host", "127.0.0.1", "--port", self.port)

    @property
    def address(self):
        return f"tls://127.0.0.1:{self.port}"

    def worker(self, *more, path=ROOT):
        """The last of two equal options counts."""
        return self._start("Registered to", "worker", "--host", "127.0.0.1", "--nworkers", "1", *more, path=path)

    def _start(self, sign, part, *more, path=ROOT):
        process = started(*line_for(self.trust, part, port=self.port), *more, trust=".", cwd=self.trust, path=path)
        self._until_end.callback(end, process)
        self.processes.append(process)
        for line in process.stderr:
            if sign in line:
                return process
        raise AssertionError(f"dask {part} ended with {process.wait()}")


def end(process):
    """Kill a process and those that it started, as a power cut does; what it had said."""
    if process.poll() is None:
        for one in [*psutil.Process(process.pid).children(recursive=True), process]:
            one.kill()
    return "" if process.stderr.closed else process.communicate()[1]


@pytest.fixture
def machines(trust):
    with ExitStack() as until_end:
        yield Machines(trust, until_end)


@pytest.fixture(scope="module")
def cluster(trust):
    """A scheduler with one worker for all tests that leave both alive."""
    with ExitStack() as until_end:
        machines = Machines(trust, until_end)
        machines.worker()
        yield machines


@contextmanager
def joined(machines, monkeypatch):
    """A crew of this process; dask read its configuration before."""
    import dask.config
    import distributed  # noqa: F401 - its defaults must be there before others are put over them

    monkeypatch.setenv("DASK_CONFIG", str(machines.trust))
    read = dask.config.merge(dask.config.config, dask.config.collect([str(machines.trust)], {}))
    with dask.config.set(read), crew_for(machines.address) as crew:
        yield crew


def wait_for_surfaces(folder, count, process):
    while len(list((folder / "results" / "default" / "surfaces").glob("r*.npz"))) < count:
        assert process.poll() is None, process.communicate()
        time.sleep(0.02)


def same_everywhere(one, other):
    """Every number of every surface and of the mosaic."""
    pairs = [(one.result().surface(f), other.result().surface(f)) for f in one.fields]
    pairs.append(tuple(data.result().mosaic().window() for data in (one, other)))
    for a, b in pairs:
        for layer in ("z_um", "confidence", "all_in_focus", "origin"):
            np.testing.assert_array_equal(getattr(a, layer), getattr(b, layer))
    return len(pairs)


@pytest.mark.campaign
def test_a_job_on_a_cluster_that_loses_a_worker_is_the_same_to_the_last_bit(alone, fresh, machines):
    first, _ = machines.worker(), machines.worker()
    running = started("wafer_viewer", "stitch", fresh, "--scheduler", machines.address, trust=machines.trust)
    wait_for_surfaces(fresh, 3, running)
    end(first)
    out, err = running.communicate(timeout=240)
    assert (running.returncode, err) == (0, "")
    assert '"measured_fraction"' in out
    assert same_everywhere(alone, Dataset.open(fresh)) == 2 * COLS + 1
    assert not list(fresh.rglob("*.part"))


@pytest.mark.campaign
def test_a_cluster_of_ones_own_does_the_same(alone, fresh):
    done = process("stitch", fresh, "--workers", "2")
    assert (done.returncode, done.stderr) == (0, "")
    assert same_everywhere(alone, Dataset.open(fresh)) == 2 * COLS + 1


@pytest.mark.campaign
@pytest.mark.parametrize("own", [True, False], ids=["own", "joined"])
def test_ctrl_c_keeps_finished_fields_and_the_next_run_continues(alone, fresh, trust, own, request):
    who = ("--workers", "2") if own else ("--scheduler", request.getfixturevalue("cluster").address)
    running = started("wafer_viewer", "stitch", fresh, *who, trust=trust)
    wait_for_surfaces(fresh, 2, running)
    os.killpg(running.pid, signal.SIGINT)  # as a terminal does
    assert running.communicate(timeout=60)[1] == "wafer-viewer: stopped.\n"
    assert running.returncode == 130
    assert not list(fresh.rglob("*.part"))
    surfaces = {f: f.stat().st_mtime_ns for f in fresh.rglob("r*.npz")}
    assert 2 <= len(surfaces) < 2 * COLS
    done = viewer("stitch", fresh, "--workers", "1")
    assert done.returncode == 0, done.stderr
    assert all(f.stat().st_mtime_ns == at for f, at in surfaces.items())
    assert same_everywhere(alone, Dataset.open(fresh)) == 2 * COLS + 1


def test_a_worker_that_joins_later_is_used(cluster, monkeypatch):
    with joined(cluster, monkeypatch) as crew:
        outcomes = crew.each(worker_tasks.work_a_while, [(i,) for i in range(10**6)])
        first = next(outcomes).value
        other = cluster.worker()
        assert next(done.value for done in outcomes if done.value != first)
        outcomes.close()
    end(other)


@pytest.mark.campaign
def test_a_field_that_cannot_be_is_named_and_left_out(dataset, fresh, cluster):
    broken = sorted((fresh / "frames").iterdir())[-1]
    broken.write_bytes(b"no images")
    done = process("stitch", fresh, "--scheduler", cluster.address, trust=cluster.trust)
    assert done.returncode == 0, done.stderr
    assert done.stderr.startswith("wafer-viewer: Field 8 has no heights and is left out.")
    assert broken.name in done.stderr
    assert len(list(fresh.rglob("r*.npz"))) == 2 * COLS - 1


def test_strangers_are_refused_in_a_sentence(fresh, cluster, tmp_path):
    open_door = viewer("stitch", fresh, "--scheduler", "tcp://127.0.0.1:8786")
    assert (open_door.returncode, "must begin with tls://" in open_door.stderr) == (2, True)
    nothing = viewer("stitch", fresh, "--scheduler", cluster.address)
    assert (nothing.returncode, "names no certificates" in nothing.stderr) == (2, True)
    stranger = process("stitch", fresh, "--scheduler", cluster.address, trust=trusted(tmp_path))
    assert (stranger.returncode, f"no cluster at {cluster.address}" in stranger.stderr) == (2, True)
    assert stranger.stderr.count("\n") == 1
    both = viewer("stitch", fresh, "--scheduler", cluster.address, "--workers", "2")
    assert (both.returncode, "give one of them" in both.stderr) == (2, True)
    assert not list(fresh.rglob("*.npz"))


def answers_plain_http(port):
    """Whether something answers a request without TLS."""
    with suppress(OSError), socket.create_connection(("127.0.0.1", port), 5) as wire:
        wire.sendall(b"GET / HTTP/1.0\r\n\r\n")
        wire.settimeout(5)
        return wire.recv(16).startswith(b"HTTP/")
    return False


def listening_ports(*pids):
    """TCP ports on which processes and their children listen."""
    above = [psutil.Process(pid) for pid in pids]
    family = [each for process in above for each in (process, *process.children(recursive=True))]
    found = [c for process in family for c in process.net_connections("tcp") if c.status == psutil.CONN_LISTEN]
    assert {c.laddr.ip for c in found} <= {"127.0.0.1"}
    return sorted({c.laddr.port for c in found})


def test_nothing_of_a_cluster_of_ones_own_answers_plain_http():
    before = set(listening_ports(os.getpid()))
    with client_of(None, 2) as client:
        client.wait_for_workers(2)
        ports = set(listening_ports(os.getpid())) - before
        assert not [port for port in ports if answers_plain_http(port)]
        assert len(ports) == 5  # scheduler, two workers and their nannies, each with TLS
        assert client.submit(sum, [1, 2]).result() == 3


def opens_to(port, credentials=None):
    """Whether a program with these credentials of another cluster, or with none, gets a word from a port."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    if credentials is not None:
        context.load_cert_chain(credentials / "certificate.pem", credentials / "key.pem")
    with (
        suppress(OSError),
        socket.create_connection(("127.0.0.1", port), 10) as plain,
        context.wrap_socket(plain) as wire,
    ):
        return bool(wire.recv(1))
    return False


def test_a_foreign_program_gets_no_word_from_a_cluster_of_ones_own(trust):
    before = set(listening_ports(os.getpid()))
    with client_of(None, 1) as client:
        client.wait_for_workers(1)
        ports = set(listening_ports(os.getpid())) - before
        assert len(ports) == 3
        assert not [port for port in ports if opens_to(port) or opens_to(port, trust)]
        assert client.submit(sum, [1, 2]).result() == 3


def test_nothing_of_a_cluster_of_several_machines_answers_plain_http(cluster):
    ports = listening_ports(*(process.pid for process in cluster.processes[:2]))
    assert not [port for port in ports if answers_plain_http(port)]
    assert len(ports) == 3


def test_certificates_are_for_their_owner_and_never_overwritten(trust):
    assert {f.stat().st_mode & 0o077 for f in (trust, *trust.iterdir()) if f.suffix != ".txt"} == {0}
    again = viewer("cluster", trust)
    assert (again.returncode, "exists already" in again.stderr) == (2, True)


@pytest.fixture
def other_program(tmp_path):
    """The folder of a program that is not quite ours."""
    other = shutil.copytree(ROOT / "wafer_viewer", tmp_path / "other" / "wafer_viewer").parent
    with (other / "wafer_viewer" / "__init__.py").open("a") as file:
        file.write("# changed\n")
    (other / "tests").symlink_to(ROOT / "tests")
    return other


def test_a_worker_with_another_program_takes_no_task(fresh, machines, other_program):
    machines.worker(path=other_program)
    refused = process("stitch", fresh, "--scheduler", machines.address, trust=machines.trust)
    assert refused.returncode == 2
    assert f"worker on {socket.gethostname()} runs wafer-viewer" in refused.stderr


@pytest.mark.campaign
def test_an_unfit_worker_that_joins_later_leaves_the_work_to_the_others(fresh, cluster, other_program, monkeypatch):
    with joined(cluster, monkeypatch) as crew:
        crew.require_sight(fresh)
        outcomes = crew.each(worker_tasks.work_a_while, [(i,) for i in range(10**6)])
        first = next(outcomes).value
        unfit = cluster.worker(path=other_program)
        assert {next(outcomes).value for _ in range(300)} == {first}
        outcomes.close()
    assert "It takes no more tasks" in end(unfit)


def test_a_folder_that_workers_do_not_see_is_named(fresh, cluster, monkeypatch):
    with joined(cluster, monkeypatch) as crew, pytest.raises(ComputeError, match=r"does not see .*nowhere\.wafer"):
        crew.require_sight(Path("/nowhere.wafer"))


@pytest.mark.campaign
def test_a_worker_over_its_limit_is_restarted_and_mapped_files_do_not_count(machines, monkeypatch, tmp_path):
    machines.worker("--memory-limit", str(MEMORY_BYTES))
    (big := tmp_path / "big").touch()
    os.truncate(big, 2 * MEMORY_BYTES)
    with joined(machines, monkeypatch) as crew:
        assert [done.fault for done in crew.each(worker_tasks.read_mapped, [(big,)] * 3)] == [None] * 3
        done = {d.index: d for d in crew.each(worker_tasks.hold, [(1000,), (2 * MEMORY_BYTES,), (2000,)])}
    assert (done[0].value, done[2].value) == (1000, 2000)
    assert "it may need more memory" in str(done[1].fault)

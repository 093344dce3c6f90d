"""The command line as people use it: a process, its output, its status, and what it leaves behind."""

from __future__ import annotations

import json
import re
import signal
import socket
import sys
import time
from subprocess import DEVNULL

import numpy as np
import pytest
import tifffile

from tests.support.command_line import process, refused, start, viewer
from tests.support.paths import ROOT
from wafer_viewer.cli.app import commands, main
from wafer_viewer.model.spec import settings_of
from wafer_viewer.model.surface.recipe import Recipe
from wafer_viewer.session.surface import kernel_build
from wafer_viewer.store.dataset.dataset import Dataset

pytestmark = pytest.mark.slow

PLAN = """
z_start_um = -6.0
[grid]
rows = 1
cols = 2
field_width_um = 336.4488
field_height_um = 252.3366
x0_um = 600.0
y0_um = 560.0
[sweep]
z_step_um = 4.0
n_frames = {frames}
"""


@pytest.fixture(scope="module")
def plan(tmp_path_factory):
    path = tmp_path_factory.mktemp("plan") / "plan.toml"
    path.write_text(PLAN.format(frames=12))
    return path


@pytest.fixture(scope="module")
def scan(plan):
    path = plan.parent / "scan.wafer"
    done = viewer("scan", plan, "-o", path)
    assert done.returncode == 0, done.stderr
    assert "24 of 24 frames" in done.stdout
    return path


@pytest.fixture(scope="module")
def surface(scan):
    path = scan.parent / "surface.npz"
    done = viewer("reconstruct", scan, "-o", path)
    assert done.returncode == 0, done.stderr
    return path


@pytest.fixture
def images(tmp_path):
    folder = tmp_path / "images"
    folder.mkdir()
    random = np.random.default_rng(1)
    texture = random.normal(0, 1, (80, 120))
    for k in range(10):
        sharp = 5 + 60 * np.exp(-((k - 5) ** 2) / 4)
        image = (128 + sharp * texture + random.normal(0, 1, texture.shape)).clip(0, 255).astype(np.uint8)
        tifffile.imwrite(folder / f"k{k}.tif", image)
    return folder


def test_a_process_prints_help_and_ends_with_its_status(tmp_path):
    printed = process("--help")
    assert printed.returncode == 0
    assert all(f"  {name} " in printed.stdout for name in commands())
    assert "none.toml cannot be read" in refused("plan", "none.toml", cwd=tmp_path, run=process)


def test_every_command_explains_itself_without_frames():
    for command in commands():
        printed = viewer(*command.split(), "--help")
        assert printed.returncode == 0, printed.stderr
        assert printed.stdout.startswith(f"usage: wafer-viewer {command} ")
        assert not set("│╭─╰") & set(printed.stdout), command
        assert "---" not in printed.stdout, command
    assert viewer("--version").stdout.startswith("wafer-viewer ")


@pytest.mark.campaign
def test_a_person_at_a_terminal_reads_a_few_lines(surface, monkeypatch, capsys):
    words = ("measure", "step", str(surface), "--upper", 600, 560, 640, 600, "--lower", 700, 560, 740, 600)
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True, raising=False)
    assert main(list(map(str, words))) == 0
    read = capsys.readouterr().out
    assert re.match(r"StepHeight: height -?\d+\.\d+ ± \d+\.\d+ um \(k = 2(\.\d\d)?\)\n  at joint ", read)
    assert "Levelled to the upper face" in read
    assert main([*map(str, words), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["type"] == "step_height"


def test_a_group_alone_lists_its_commands_with_their_answers_by_family():
    printed = viewer("measure")
    assert (printed.returncode, printed.stderr) == (0, "")
    assert printed.stdout == viewer("measure", "--help").stdout
    families = dict(block.split("\n", 1) for block in printed.stdout.split("\n\n")[1:-1])
    assert "measure step          the height of one region over another" in families["Sections and steps"]
    assert "measure texture" in families["Faces"]
    assert "measure defects" in families["Dies, gauge blocks and verdicts"]
    every = [command for command in commands() if command.startswith("measure ")]
    assert all(printed.stdout.count(f"  {command} ") == 1 for command in every)
    assert "calibrate delay" in viewer("calibrate").stdout


def test_a_plan_is_priced_as_a_table_and_as_json(plan):
    table = viewer("plan", plan)
    assert table.returncode == 0, table.stderr
    assert "Z passes, up and down" in table.stdout
    priced = json.loads(viewer("plan", plan, "--json").stdout)
    assert priced["n_frames"] == 24
    assert {p["strategy"] for p in priced["prices"]} >= {"z_snake", "stop_and_shoot"}


def test_a_scan_is_checked_stitched_measured_and_converted(scan, surface, tmp_path):
    checked = viewer("check", scan)
    assert checked.returncode == 0
    assert "24 frames good, 0 missing, 0 damaged" in checked.stdout
    stitched = json.loads(viewer("stitch", scan).stdout)
    assert stitched["n_fields"] == 2
    step = viewer("measure", "step", scan, "--upper", 600, 560, 640, 600, "--lower", 700, 560, 740, 600)
    height = json.loads(step.stdout)["height"]
    assert height["status"] == "evaluated"
    assert height["expanded_um"] > 0
    profile = viewer("measure", "profile", surface, "--line", 500, 560, 700, 560, "--width-um", 3, "--points")
    facts = json.loads(profile.stdout)
    assert facts["simulated"]
    assert len(facts["points"]["z_um"]) == len(facts["points"]["distance_um"])
    assert viewer("convert", surface, tmp_path / "surface.ply").returncode == 0
    assert (tmp_path / "surface.ply").read_bytes().startswith(b"ply")


def test_a_pixel_says_why_it_has_its_height(scan, surface, images):
    requested = json.loads(viewer("why", scan, "--at", 745, 560).stdout)
    assert (requested["field"], requested["simulated"]) == (1, True)
    assert len(requested["z_um"]) == len(requested["focus"]) == 12
    assert {"gate", "question", "score", "limit", "passed"} <= requested["verdicts"][0].keys()
    other = json.loads(viewer("why", scan, "--at", 745, 560, "--field", 2, "--recipe.window", 5).stdout)
    assert (other["field"], other["window"]) == (2, 5)
    taken = ["why", images, "--z-step-um", 2, "--pixel-um", 0.5]
    found = json.loads(viewer(*taken, "--at", 3, -4).stdout)
    assert found["peak_z_um"] == pytest.approx(10, abs=1)
    assert 0 < found["u_um"] < 0.5
    assert "lies outside of field 1" in refused(*taken, "--at", 300, -4)
    assert "lies in no field of scan.wafer" in refused("why", scan, "--at", 0, 0)
    assert "is a surface without its frames" in refused("why", surface, "--at", 620, 560)
    assert "--at" in refused("why", scan)


def test_a_damaged_page_is_found(scan, tmp_path):
    import shutil

    copy = shutil.copytree(scan, tmp_path / "copy.wafer")
    pages = next((copy / "frames").glob("*.tif"))
    with pages.open("r+b") as file:
        file.seek(pages.stat().st_size // 2)
        file.write(b"\x55" * 8)
    checked = viewer("check", copy)
    assert checked.returncode == 1
    assert "1 damaged" in checked.stdout


def test_a_damaged_stitched_surface_is_neither_measured_nor_kept(scan, tmp_path):
    import shutil

    step = ("measure", "step", tmp_path / "copy.wafer", "--upper", 600, 560, 640, 600, "--lower", 700, 560, 740, 600)
    copy = shutil.copytree(scan, tmp_path / "copy.wafer")
    assert viewer("stitch", copy).returncode == 0
    assert "Stitched surfaces: " in viewer("check", copy).stdout
    shard = copy / "results/default/mosaic.zarr/z_raw_um/0/c/0/0"
    content = bytearray(shard.read_bytes())
    for at in range(0, len(content), 1000):  # every chunk: the step reads some of them
        content[at] ^= 32
    shard.write_bytes(content)
    checked = viewer("check", copy)
    assert checked.returncode == 1
    assert "z_raw_um/0/c/0/0 is damaged" in checked.stdout
    measured = viewer(*step)
    assert measured.returncode == 2
    assert not measured.stdout
    assert "is damaged: stitch the fields again (wafer-viewer stitch copy.wafer)" in " ".join(measured.stderr.split())
    assert viewer("stitch", copy).returncode == 0
    assert viewer("check", copy).returncode == 0
    assert viewer(*step).returncode == 0


def test_a_damaged_scan_record_is_named_by_check(scan, tmp_path):
    import shutil

    copy = shutil.copytree(scan, tmp_path / "copy.wafer")
    record = (copy / "scan.json").read_text()
    (copy / "scan.json").write_text(record.replace('"z_step_um": 4.0', '"z_step_um": 5.0'))
    assert record != (copy / "scan.json").read_text()
    checked = viewer("check", copy)
    assert checked.returncode == 1
    assert "scan.json is damaged, its checksum differs: restore it from a copy" in checked.stdout
    assert "Journal: 1 good" in checked.stdout
    assert viewer("stitch", copy).returncode == 2


def test_a_scan_names_what_slipped_and_takes_it_again(plan, scan, tmp_path):
    (tmp_path / "rig.toml").write_text("[faults]\nslips = [5]\nslip_counts = 250\nextra_edges = [20]\n")
    done = viewer("scan", plan, "--rig", tmp_path / "rig.toml", "-o", "slipped.wafer", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "24 of 24 frames kept" in done.stdout
    assert "125 quadrature errors on the z scale" in done.stderr
    assert "slipped by -250 counts (-2.50 um)" in done.stderr
    assert "taken again (try 2 of 3)" in done.stderr
    assert "counted 1 edge that the pulse box did not send" in done.stderr
    checked = viewer("check", tmp_path / "slipped.wafer")
    assert checked.returncode == 0
    assert "2 passes checked against the counts of the pulse box" in checked.stdout
    assert "none in doubt" in checked.stdout
    assert "noted during the scan: None of the 12 frames" in checked.stdout
    clean, slipped = Dataset.open(scan), Dataset.open(tmp_path / "slipped.wafer")
    for number in (1, 2):
        np.testing.assert_allclose(clean.stack(number).z_um, slipped.stack(number).z_um, atol=0.02)


def test_a_scan_that_always_slips_ends_with_a_sentence(plan, tmp_path):
    numbers = ", ".join(map(str, range(5, 200, 5)))
    (tmp_path / "rig.toml").write_text(f"[faults]\nslips = [{numbers}]\n")
    done = viewer("scan", plan, "--rig", tmp_path / "rig.toml", "-o", "slips.wafer", cwd=tmp_path)
    assert done.returncode == 2
    assert "in 3 tries of the pass that begins at field 1 no frame could be kept" in done.stderr
    assert "Check the cable and the signal of the scale" in done.stderr
    checked = viewer("check", tmp_path / "slips.wafer")
    assert checked.returncode == 1
    assert "0 frames good, 24 missing" in checked.stdout
    assert "noted during the scan: The scan cannot be trusted" in checked.stdout


def test_a_stage_that_never_arrives_ends_the_scan(plan, tmp_path):
    (tmp_path / "rig.toml").write_text("[faults]\nendless_motions = [1]\n")
    done = viewer("scan", plan, "--rig", tmp_path / "rig.toml", "-o", "hangs.wafer", cwd=tmp_path)
    assert done.returncode == 2
    assert "The stage does not report the end of its motion" in done.stderr
    assert "the z axis stands at" in done.stderr


def test_a_scan_that_was_interrupted_continues(tmp_path):
    (tmp_path / "plan.toml").write_text(PLAN.format(frames=120).replace("z_step_um = 4.0", "z_step_um = 0.1"))
    first = start("scan", "plan.toml", "-o", "long.wafer", cwd=tmp_path)
    journal = tmp_path / "long.wafer" / "journal.jsonl"
    while first.poll() is None and not (journal.exists() and journal.stat().st_size > 2000):
        time.sleep(0.01)
    first.send_signal(signal.SIGINT)
    out, err = first.communicate(timeout=240)
    assert first.returncode == 130, err
    assert "continues it" in out
    assert "Traceback" not in err
    refused("scan", tmp_path / "plan.toml", "-o", tmp_path / "long.wafer" / "frames")
    second = viewer("scan", "plan.toml", "-o", "long.wafer", cwd=tmp_path)
    assert second.returncode == 0, second.stderr
    assert "240 of 240 frames" in second.stdout
    assert "has all its frames" in refused("scan", "plan.toml", "-o", "long.wafer", cwd=tmp_path)
    (tmp_path / "plan.toml").write_text(PLAN.format(frames=121))
    assert "another plan" in refused("scan", "plan.toml", "-o", "long.wafer", cwd=tmp_path)


def test_a_damaged_frame_is_found_and_taken_again_by_the_command_that_the_check_names(tmp_path):
    (tmp_path / "plan.toml").write_text(PLAN.format(frames=6))
    assert viewer("scan", "plan.toml", "-o", "small.wafer", cwd=tmp_path).returncode == 0
    assert "has all its frames, and none is damaged" in refused("scan", "plan.toml", "-o", "small.wafer", cwd=tmp_path)
    frames = tmp_path / "small.wafer" / "frames" / "r0000c0000.tif"
    content = bytearray(frames.read_bytes())
    content[len(content) // 2] ^= 1
    frames.write_bytes(content)
    checked = viewer("check", "small.wafer", cwd=tmp_path)
    assert checked.returncode == 1
    (mend,) = [line for line in checked.stdout.splitlines() if "mend: " in line]
    command = re.search(r"\(wafer-viewer (.*)\)$", mend)[1].replace("PLAN.toml", "plan.toml").split()
    done = viewer(*command, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "12 of 12 frames kept" in done.stdout
    again = viewer("check", "small.wafer", cwd=tmp_path)
    assert again.returncode == 0, again.stdout
    assert "1 frame was damaged, of field 1: it is taken again" in again.stdout


def test_images_become_a_surface_in_one_line(images, tmp_path):
    out = tmp_path / "z.npz"
    flags = ["--z-step-um", 2, "--pixel-um", 0.5, "--recipe.window", 7, "--recipe.levy.mode", "none"]
    done = viewer("reconstruct", images, "-o", out, *flags)
    assert done.returncode == 0, done.stderr
    assert "% measured" in done.stdout
    with np.load(out) as stored:
        keys = {"z_um", "confidence", "origin", "all_in_focus", "pixel_um", "x0_um", "y0_um"}
        assert keys <= set(stored.files)
        assert np.nanmedian(stored["z_um"]) == pytest.approx(10, abs=0.5)
        assert 0 < np.nanmedian(stored["u_um"]) < 0.5
        assert np.isnan(stored["u_um"][np.isnan(stored["z_raw_um"])]).all()


def test_a_recipe_is_a_file_and_its_settings_are_flags(images, tmp_path):
    recipe = tmp_path / "recipe.toml"
    recipe.write_text('focus_measure = "glv"\nwindow = 7\n')
    src = ["reconstruct", images, "--z-step-um", 2, "--pixel-um", 0.5, "-o", tmp_path / "z.npz"]
    assert viewer(*src, "--recipe", recipe, "--recipe.window", 9).returncode == 0
    with np.load(tmp_path / "z.npz") as stored:
        used = json.loads(str(stored["provenance"]))["recipe"]
    assert (used["focus_measure"], used["window"]) == ("glv", 9)
    recipe.write_text("windwo = 7\n")
    assert "windwo" in refused(*src, f"--recipe={recipe}")
    assert "needs a file" in refused(*src, "--recipe")
    assert "cannot be read" in refused(*src, "--recipe", tmp_path / "none.toml")


def test_an_import_is_a_dataset(images, tmp_path):
    out = tmp_path / "taken.wafer"
    done = viewer("import", images, "-o", out, "--z-step-um", 2, "--pixel-um", 0.5)
    assert done.returncode == 0, done.stderr
    assert "1 fields of 10 frames" in done.stdout
    assert viewer("check", out).returncode == 0


def test_the_doctor_says_what_there_is_and_compiles_what_a_surface_needs(tmp_path, monkeypatch):
    compiled = []
    monkeypatch.setattr(kernel_build, "compile_missing", lambda parts, _: compiled.extend(parts))
    monkeypatch.setattr(kernel_build, "load_all", list)
    printed = viewer("doctor", "--data", tmp_path)
    assert printed.returncode in (0, 1), printed.stderr
    assert compiled == list(kernel_build.PARTS)
    assert "ok   Kernels: compiled for this processor" in printed.stdout
    assert "SIMULATED, answers" in printed.stdout
    assert all(line[:4] in ("ok  ", "LACK", "    ") for line in printed.stdout.splitlines())


def test_the_doctor_checks_the_devices_of_a_rig_and_moves_on_request_only(tmp_path, monkeypatch):
    monkeypatch.setattr(kernel_build, "compile_missing", lambda *_: None)
    monkeypatch.setattr(kernel_build, "load_all", list)
    rig = ROOT / "assets/rigs/zaber_simulated.toml"
    still = viewer("doctor", "--data", tmp_path, "--rig", rig).stdout
    assert "Controller 'stage' at simulated: SIMULATED, Zaber device 1" in still
    assert "not homed" in still
    moved = viewer("doctor", "--data", tmp_path, "--rig", rig, "--move").stdout
    assert "the stage moved by +500.00 um, the box counted +50000, expected were +50000" in moved


BAD_FLAGS = {
    "no such command": (("fly",), "There is no command 'fly'"),
    "half of a misspelt command": (("measure", "setp", "x"), "did you mean 'measure step'?"),
    "a misspelt command": (("serv", "--port", 8000), "did you mean 'serve'?"),
    "a misspelt group": (("measur", "step"), "did you mean 'measure'?"),
    "nothing like a command": (("measure", "soup"), "'wafer-viewer measure help' lists them"),
    "an unknown flag": (("plan", "p.toml", "--colour", "red"), "--colour red"),
    "a missing argument": (("plan",), "Missing: "),
    "a missing flag": (("reconstruct", "x"), "--out"),
    "a flag without its value": (("plan", "p.toml", "--rig"), "--rig"),
    "a word for a number": (("serve", "--port", "eighty"), "eighty"),
    "three of four numbers": (("measure", "step", "x", "--upper", 1, 2, 3, "--lower", 1, 2, 3, 4), "--upper"),
    "a wrong choice": (("stitch", "x", "--recipe.peak", "best"), "argmax, gaussian, tent"),
    "an even window": (("stitch", "x.wafer", "--recipe.window", 4), "Recipe.window is 4"),
    "an unknown setting": (("stitch", "x.wafer", "--recipe.windwo", 4), "--recipe.windwo"),
    "no plan": (("plan", "none.toml"), "none.toml cannot be read"),
    "no rig": (("plan", "none.toml", "--rig", "none-rig.toml"), "none"),
    "no dataset": (("check", "none.wafer"), "none.wafer does not exist"),
    "no surface": (("convert", "none.npz", "x.ply"), "none.npz does not exist"),
    "an unknown ending": (("convert", "none.npz", "x.docx"), ".docx"),
    "no images": (("reconstruct", "-o", "x.npz"), "There are no images"),
    "an empty folder": (("reconstruct", ".", "-o", "x.npz", "--z-step-um", 1, "--pixel-um", 1), "image"),
    "nowhere": (("import", "nowhere", "-o", "x.wafer", "--z-step-um", 1, "--pixel-um", 1), "nowhere"),
    "no port": (("serve", "--port", 99999), "--port is 99999"),
}


def test_a_wrong_command_line_is_one_sentence_and_leaves_nothing(tmp_path):
    for case, (words, printed) in BAD_FLAGS.items():
        assert printed in refused(*words, cwd=tmp_path), case
        assert not list(tmp_path.iterdir()), case


BAD_PLANS = {
    "overlap over half": ("cols = 2", "cols = 2\noverlap_x_fraction = 0.6", "overlap_x_fraction is 0.6"),
    "no fields": ("cols = 2", "cols = 0", "cols is 0"),
    "too few frames": ("n_frames = 12", "n_frames = 2", "n_frames is 2"),
    "no step": ("z_step_um = 4.0", "z_step_um = 0.0", "z_step_um is 0.0"),
    "out of the stage's range": ("x0_um = 600.0", "x0_um = 6e6", "6000"),
    "an unknown key": ("cols = 2", "cols = 2\ncolour = 1", "colour"),
    "no TOML": ("[grid]", "[grid", "plan.toml"),
}


def test_a_wrong_plan_is_one_sentence_and_nothing_is_scanned(tmp_path):
    for case, (good, bad, printed) in BAD_PLANS.items():
        (tmp_path / "plan.toml").write_text(PLAN.format(frames=12).replace(good, bad))
        assert printed in refused("scan", "plan.toml", "-o", "new.wafer", cwd=tmp_path), case
        assert [p.name for p in tmp_path.iterdir()] == ["plan.toml"], case


@pytest.mark.parametrize("command", ["import", "reconstruct"])
@pytest.mark.parametrize("case", ["size", "truncated", "text", "two frames", "no pixel size"])
def test_bad_images_are_one_sentence_and_nothing_is_written(command, case, images, tmp_path):
    flags = ["--z-step-um", 2, "--pixel-um", 0.5]
    if case == "size":
        tifffile.imwrite(images / "k4.tif", np.zeros((80, 121), np.uint8))
    elif case == "truncated":
        (images / "k4.tif").write_bytes((images / "k4.tif").read_bytes()[:900])
    elif case == "text":
        (images / "k4.tif").write_text("this is a text")
    elif case == "two frames":
        for k in range(2, 10):
            (images / f"k{k}.tif").unlink()
    else:
        flags = flags[:2]
    out = "x.wafer" if command == "import" else "x.npz"
    printed = refused(command, images, "-o", out, *flags, cwd=tmp_path)
    assert ("k4.tif" in printed) == (case in ("size", "truncated", "text"))
    assert [p.name for p in tmp_path.iterdir()] == ["images"]


def test_a_place_that_cannot_be_written_is_one_sentence(images, tmp_path):
    (tmp_path / "file").write_text("")
    src = [images, "--z-step-um", 2, "--pixel-um", 0.5]
    assert "cannot be written" in refused("import", *src, "-o", tmp_path / "file" / "x.wafer")
    assert "cannot be written" in refused("reconstruct", *src, "-o", tmp_path / "file" / "x.npz")
    assert "is a file" in refused("serve", "--data", tmp_path / "file")


def test_a_port_in_use_is_one_sentence(tmp_path):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        assert f"Port {port} is in use" in refused("serve", "--port", port, "--data", tmp_path)


def test_the_viewer_prints_its_address_and_ends_with_ctrl_c(tmp_path):
    running = start("serve", "--port", 0, "--data", tmp_path)
    line = running.stdout.readline()
    assert "http://127.0.0.1:" in line
    assert "token=" in line
    running.send_signal(signal.SIGINT)
    _, err = running.communicate(timeout=60)
    assert running.returncode == 0
    assert err == ""


@pytest.mark.campaign
def test_a_page_for_other_machines_needs_a_password_and_is_served_by_tls(tmp_path):
    other = "serve", "--host", "127.0.0.2", "--port", 0, "--data", tmp_path
    no_terminal = process(*other, stdin=DEVNULL)
    assert no_terminal.returncode == 2
    assert "without a password: start it once in a terminal" in no_terminal.stderr
    assert "is for a page that others reach" in refused("serve", "--new-password", "--data", tmp_path)
    (tmp_path / "secret").write_text("correct horse battery\n")
    running = start(*other, "--password-file", tmp_path / "secret")
    told = [running.stdout.readline() for _ in range(3)]
    running.send_signal(signal.SIGINT)
    out, err = running.communicate(timeout=60)
    assert (running.returncode, err) == (0, "")
    assert "Wafer Viewer is at https://127.0.0.2:" in told[0]
    assert "log in with the password" in told[1]
    assert len(told[2].strip().split(":")) == 32  # the fingerprint of the self-signed certificate
    assert "correct horse" not in "".join((*told, out))


def test_regions_off_the_surface_are_refused(surface):
    far = refused("measure", "step", surface, "--upper", 9e5, 0, 9.1e5, 10, "--lower", 700, 560, 740, 600)
    assert "lies outside" in far
    twice = refused("measure", "step", surface, "--upper", 600, 560, 640, 600, "--lower", 610, 560, 640, 600)
    assert "wafer-viewer: " in twice


def test_help_explains_every_setting_of_a_recipe():
    told = " ".join(viewer("reconstruct", "--help").stdout.split())
    for field in settings_of(Recipe).values():
        assert f"{field.setting.title}{f', {field.setting.unit}' if field.setting.unit else ''}. " in told

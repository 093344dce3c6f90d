#!/usr/bin/env bash
# Write anew what is installed: tests/lock.txt, tests/lock_alone.txt and assets/constraints.txt.
#
# The versions are those of the environment that the tests have just passed in; only the hashes come from the registry,
# for all files of a version, so that one lock serves Python 3.11 to 3.13.
set -euo pipefail
cd "$(dirname "$0")/.."
venv="${WAFER_VIEWER_VENV:-$PWD/.venv}"
folder="$(mktemp -d)"
trap 'rm -r "$folder"' EXIT
"$venv/bin/python" -m venv "$folder/uv"
"$folder/uv/bin/pip" install --quiet --disable-pip-version-check uv
"$venv/bin/python" -m pip freeze --exclude-editable | grep == >"$folder/installed.txt"
printf '%s\n' hatchling editables >"$folder/build.in" # what builds the package itself
echo adafruit-circuitpython-pioasm >"$folder/alone.in"

write() {
  local out="$1" says="$2"
  shift 2
  {
    echo "# $says"
    echo "# Written by tests/renew_lock.sh."
    "$folder/uv/bin/uv" pip compile --quiet --system-certs --no-header --no-annotate --python-version 3.11 \
      --python-platform x86_64-manylinux_2_35 --constraints "$folder/installed.txt" "$@"
  } >"$folder/out"
  mv "$folder/out" "$out"
}

write tests/lock.txt "Everything that the tests run with, by hash: pip install --require-hashes -r tests/lock.txt" \
  --generate-hashes --extra dev pyproject.toml "$folder/build.in"
write tests/lock_alone.txt "By hash too, but without its dependencies, which are for boards." \
  --generate-hashes --no-deps "$folder/alone.in"
write assets/constraints.txt "Versions that the tests passed with: pip install -c assets/constraints.txt ." pyproject.toml

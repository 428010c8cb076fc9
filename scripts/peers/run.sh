#!/usr/bin/env bash
# hydrograd beside JAX-SPH: same scenes, same machine, in turns. One command from a bare clone:
#
#     scripts/peers/run.sh [--quick] [--hydrograd target/release/hydrograd] [--no-accuracy]
#     scripts/peers/run.sh --surrogate [--quick] [--hydrograd PATH]      the graph network beside PyTorch and LagrangeBench
#
# Makes a Python environment with JAX-SPH on the first call (Python 3.10 or 3.11, about 1.5 GB, one minute), builds hydrograd if
# it is not there, and checks that JAX-SPH gives its own published states. Writes runs/peers/peers.json and table.md (--quick:
# 4 minutes, else half an hour) and runs/peers/accuracy.json. HYDROGRAD_PEERS names another folder for the environment
# (~/.cache/hydrograd/peers). --surrogate runs that part alone (about 9 minutes; --quick: 3): another environment beside the first
# (with `-surrogate` behind its name; 1.5 GB, 6 GB where PyTorch's own index can not be reached), runs/peers/surrogate.json
# and surrogate.md.
set -euo pipefail
cd "$(dirname "$0")/../.."
quick="" hydrograd=target/release/hydrograd accuracy=yes surrogate=no
while [ $# -gt 0 ]; do
    case "$1" in
        --quick) quick=--quick ;;
        --no-accuracy) accuracy=no ;;
        --surrogate) surrogate=yes ;;
        --hydrograd) hydrograd="${2:?--hydrograd needs the path of the program}"; shift ;;
        -h | --help) sed -n '2,13s/^# \{0,1\}//p' "$0"; exit 0 ;;
        *) echo "run.sh: unknown option $1; allowed: --quick, --no-accuracy, --surrogate, --hydrograd PATH" >&2; exit 2 ;;
    esac
    shift
done
environment="${HYDROGRAD_PEERS:-${XDG_CACHE_HOME:-$HOME/.cache}/hydrograd/peers}"
requirements=(scripts/peers/requirements.txt)
if [ "$surrogate" = yes ]; then
    environment="$environment-surrogate"
    requirements+=(scripts/peers/requirements-surrogate.txt)
fi
if ! cmp -s <(cat "${requirements[@]}") "$environment/requirements.txt"; then
    echo "installing JAX-SPH (--surrogate: LagrangeBench and PyTorch) into $environment" >&2
    rm -rf "$environment"
    python3 -m venv "$environment"
    pip=("$environment/bin/pip" --disable-pip-version-check install -q)
    "${pip[@]}" --no-deps --ignore-requires-python "${requirements[@]/#/-r}" >&2
    if [ "$surrogate" = yes ]; then
        "${pip[@]}" torch --index-url https://download.pytorch.org/whl/cpu >&2 2> /dev/null || "${pip[@]}" torch >&2 ||
            echo "run.sh: PyTorch can not be installed here, so its rows are left out" >&2
    fi
    cat "${requirements[@]}" > "$environment/requirements.txt"
fi
if [ ! -x "$hydrograd" ]; then
    [ "$hydrograd" = target/release/hydrograd ] || { echo "run.sh: --hydrograd $hydrograd is not a program" >&2; exit 2; }
    cargo build --release >&2
fi
python="$environment/bin/python"
export PYTHONPATH= PYTHONDONTWRITEBYTECODE=1
if [ "$surrogate" = yes ]; then
    without=()
    "$python" -c "import torch" 2> /dev/null || without=(--without PyTorch --without "PyTorch, split edge layer")
    "$python" -c "import haiku, jax, jraph" || without+=(--without LagrangeBench)
    exec "$python" scripts/peers/surrogate.py $quick --hydrograd "$hydrograd" --out runs/peers ${without[@]+"${without[@]}"}
fi
"$python" scripts/peers/check.py >&2
"$python" scripts/peers/compare.py $quick --hydrograd "$hydrograd" --out runs/peers
if [ "$accuracy" = yes ]; then
    "$python" scripts/peers/jax_sph_accuracy.py $quick --out runs/peers/accuracy.json
fi

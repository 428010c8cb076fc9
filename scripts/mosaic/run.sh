#!/usr/bin/env bash
# hydrograd in Mosaic, the benchmark of differentiable flow solvers (pasteurlabs/mosaic), beside the peers that run on a CPU:
#
#     scripts/mosaic/run.sh [--quick] [--only SOLVER]... [--wheel FILE] [--mosaic CHECKOUT]
#
# Clones the benchmark at the commit below and makes a Python environment on the first call (Python 3.11, 3 GB; needs git, python3-venv and
# what `cargo build` needs), builds the wheel of hydrograd, and runs each solver in a process of its own, with one thread. Writes
# runs/mosaic/rows.csv, table.md and pictures; an hour and more, most of it PhiFlow's and compilers' (--quick: hydrograd and Warp,
# minutes). --only runs some solvers and keeps the rows of the others. Solvers: hydrograd, warp-ns, jax-cfd, xlb, phiflow, exponax.
# HYDROGRAD_MOSAIC names another folder for the environment; the clone is beside it, or is what --mosaic names.
set -euo pipefail
cd "$(dirname "$0")/../.."
commit=a535cb3 source=https://github.com/pasteurlabs/mosaic
only=() wheel="" mosaic="" quick=no
while [ $# -gt 0 ]; do
    case "$1" in
        --quick) quick=yes ;;
        --only) only+=("${2:?--only needs a solver}"); shift ;;
        --wheel) wheel="${2:?--wheel needs a file}"; shift ;;
        --mosaic) mosaic="${2:?--mosaic needs a folder}"; shift ;;
        -h | --help) sed -n '2,10s/^# \{0,1\}//p' "$0"; exit 0 ;;
        *) echo "run.sh: unknown option $1; allowed: --quick, --only SOLVER, --wheel FILE, --mosaic CHECKOUT" >&2; exit 2 ;;
    esac
    shift
done
[ "$quick" = no ] || [ ${#only[@]} -gt 0 ] || only=(hydrograd warp-ns)
[ ${#only[@]} -gt 0 ] || only=(hydrograd warp-ns jax-cfd xlb phiflow exponax)
environment="${HYDROGRAD_MOSAIC:-${XDG_CACHE_HOME:-$HOME/.cache}/hydrograd/mosaic}"
# First what may be missing: the peers take minutes to install.
if [ -z "$mosaic" ]; then
    mosaic="$environment-checkout"
    if ! git -C "$mosaic" cat-file -e "$commit^{commit}" 2> /dev/null; then
        rm -rf "$mosaic"
        mkdir -p "$(dirname "$mosaic")"
        git clone -q "$source" "$mosaic" >&2 || {
            echo "run.sh: $source cannot be cloned; where it cannot be reached: --mosaic FOLDER with a checkout of it at $commit" >&2
            exit 1
        }
    fi
    git -C "$mosaic" checkout -q "$commit"
elif [ ! -d "$mosaic/mosaic/benchmarks" ]; then
    echo "run.sh: --mosaic $mosaic: no folder mosaic/benchmarks there; allowed: a checkout of $source at $commit" >&2
    exit 2
fi
mosaic=$(realpath "$mosaic")
if ! cmp -s scripts/mosaic/requirements.txt "$environment/requirements.txt"; then
    echo "installing the peers into $environment" >&2
    rm -rf "$environment"
    python3 -m venv "$environment"
    "$environment/bin/pip" --disable-pip-version-check install -q -r scripts/mosaic/requirements.txt >&2
    # XLB 0.3.1 imports a module that its wheel lacks.
    sed -i '/ibm_stepper/d' "$environment"/lib/python3*/site-packages/xlb/operator/stepper/__init__.py
    cp scripts/mosaic/requirements.txt "$environment/requirements.txt"
fi
if [ -z "$wheel" ]; then
    (cd src/python && PATH="$environment/bin:$PATH" maturin build --release --out dist) >&2
    wheel=$(ls -t src/python/dist/hydrograd-*.whl | head -n 1)
fi
"$environment/bin/pip" --disable-pip-version-check install -q --no-deps --force-reinstall "$wheel" >&2
out=runs/mosaic
mkdir -p "$out"
export MOSAIC="$mosaic" OMP_NUM_THREADS=1 CANDLE_NUM_THREADS=1
export XLA_FLAGS="--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"
two=baseline,tgv,multimode,laws,fd,cost three=b3,a3,f3,c3
for solver in "${only[@]}"; do
    api="$mosaic/mosaic/tesseracts/navier-stokes-grid/$solver/tesseract_api.py"
    case "$solver" in
        hydrograd)
            api=$("$environment/bin/python" -c "import hydrograd, os; print(os.path.dirname(hydrograd.__file__))")
            api="$api/navier_stokes_grid/tesseract_api.py" tasks="$two,horizon,cylinder,drag,$three" ;;
        warp-ns) tasks="$two,$three" ;;
        exponax) tasks="$three" ;;
        phiflow) tasks="baseline,tgv,multimode,laws,fd,cost,b3,a3" ;;
        *) tasks="$two" ;;
    esac
    [ "$quick" = no ] || tasks=baseline,tgv,multimode,laws,fd,cost,a3
    rows="$out/$solver.csv"
    rm -f "$rows"
    for task in ${tasks//,/ }; do
        timeout 1800 "$environment/bin/python" scripts/mosaic/run.py --api "$api" --key "${solver//-/_}" \
            --tasks "$task" --out "$rows" || echo "run.sh: $solver $task failed" >&2
    done
done
"$environment/bin/python" scripts/mosaic/report.py "$out"

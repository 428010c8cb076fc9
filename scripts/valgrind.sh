#!/usr/bin/env bash
# Tests of the unsafe code (SIMD lanes, sweeps that write from several threads, the neighbour search) under valgrind: no
# access out of bounds, no use of memory that was never written. Valgrind knows no AVX-512, so the AVX2 and the portable
# kernels run. About half an hour, and twice that on a busy machine. Debian: apt-get install valgrind
set -euo pipefail
cd "$(dirname "$0")/.."
command -v valgrind >/dev/null || { echo "valgrind.sh: valgrind is not installed; apt-get install valgrind" >&2; exit 2; }
program=$(cargo test --release --no-run --test all 2>&1 | sed -n 's/^ *Executable .*(\(.*\))$/\1/p')
test -n "$program" || { echo "valgrind.sh: cargo built no tests" >&2; exit 1; }
for set in avx2 portable; do
    # Of the operators' tests those that run every kernel once: central differences take hours here.
    echo "== $set"
    HYDROGRAD_SIMD=$set CANDLE_NUM_THREADS=2 RAYON_NUM_THREADS=2 \
        valgrind -q --error-exitcode=1 "$program" kernels:: neighbours:: operators::fused_is_composed --test-threads 1
done

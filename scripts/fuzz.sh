#!/usr/bin/env bash
# Readers of files fed with whatever a fuzzer makes of good ones, a time for each (60 s unless told otherwise): no panic, no read
# out of bounds, no message that can not be shown. Needs a nightly compiler and `cargo install cargo-fuzz`. Names of targets as
# arguments; all unless told. What breaks one is left in tests/fuzz/artifacts.
set -euo pipefail
cd "$(dirname "$0")/.."
command -v cargo-fuzz >/dev/null || { echo "fuzz.sh: cargo-fuzz is not installed; cargo install cargo-fuzz" >&2; exit 2; }
seconds=${HYDROGRAD_FUZZ:-60}
targets=${*:-scene columns tensors model metadata state}
# Good files to begin with, small ones.
corpus=${CARGO_TARGET_DIR:-target}/fuzz-corpus
program=${HYDROGRAD:-target/release/hydrograd}
[ -x "$program" ] || cargo build --release
seeds=$(mktemp -d)
trap 'rm -rf "$seeds" /dev/shm/hydrograd-fuzz-*' EXIT
mkdir -p "$seeds"/{scene,columns,tensors,model,metadata,state}
cp data/scenes/*.toml data/scenes/presets/*.toml data/scenes/examples/*.toml "$seeds/scene"
"$program" optimize --no-verify --epochs 1 --set time.end=0.1 --set objective.window=0.05 --set resolution.dx=0.025 \
    --set output.frames=0 --out "$seeds/run" >/dev/null
cp "$seeds/run/shape.csv" "$seeds/columns"
cp "$seeds/run/checkpoint.safetensors" "$seeds/tensors"
cp "$seeds/run/state.h5" "$seeds/state"
"$program" generate heated-channel --set resolution.dx=0.025 --trajectories 1/1/1 --frames 12 --skip 20 --out "$seeds/data" >/dev/null
cp data/reference/gns/tgv_small/metadata.json "$seeds/metadata/lagrangebench.json"
cp "$seeds/data/metadata.json" "$seeds/metadata/own.json"
"$program" train --data "$seeds/data" --steps 2 --set model.latent=8 --set model.rounds=1 --set validation_windows=1 \
    --set validation_steps=2 --out "$seeds/train" >/dev/null
cp "$seeds/train/last.safetensors" "$seeds/model"
for target in $targets; do
    echo "== $target, $seconds s"
    mkdir -p "$corpus/$target"
    # Its warnings on bad input are not news.
    # HDF5 loses some bytes of memory where it gives up on a file.
    leaks=$([ "$target" = state ] && echo 0 || echo 1)
    cargo +nightly fuzz run --fuzz-dir tests/fuzz "$target" "$corpus/$target" "$seeds/$target" -- -detect_leaks="$leaks" \
        -max_total_time="$seconds" -timeout=20 -rss_limit_mb=4096 -print_final_stats=1 2>&1 |
        grep -E "^(stat::|thread|SUMMARY|error|==|Done)|panicked|cov:" | tail -12
done

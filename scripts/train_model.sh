#!/usr/bin/env bash
# From nothing to models/heated-channel: data, four trainings, evaluation, model and curves copied. About 70 minutes with one core.
#
#   cargo build --release && scripts/train_model.sh
#   OUT=/tmp/model BOUND=0.02 THREADS=2 scripts/train_model.sh
#
# HYDROGRAD  the program (default: target/release/hydrograd)
# OUT        folder of data sets and trainings (default: runs/model); what is there already is gone on with
# BOUND      walls of the data are within this (default: 0.03); the report's walls are within 0.02. No search may leave it
# THREADS    worker threads (default: 1); the parameters are the same with any number
# MODEL      where model and curves go (default: models/heated-channel)
set -euo pipefail
cd "$(dirname "$0")/.."
HYDROGRAD=${HYDROGRAD:-target/release/hydrograd}
OUT=${OUT:-runs/model}
BOUND=${BOUND:-0.03}
THREADS=${THREADS:-1}
MODEL=${MODEL:-models/heated-channel}
command -v "$HYDROGRAD" >/dev/null || { echo "train_model.sh: no $HYDROGRAD; cargo build --release, or name it in HYDROGRAD" >&2; exit 2; }
mkdir -p "$OUT" "$MODEL"

# A data set: its name, then what differs. Half of the flows begin at rest, half developed.
data() {
    local name=$1; shift
    test -f "$OUT/$name/metadata.json" ||
        "$HYDROGRAD" generate heated-channel --starts mix --set design.bound="$BOUND" --threads "$THREADS" --out "$OUT/$name" "$@"
}

# A training: its name, its data set, the training that it begins with or `-`, then its settings.
train() {
    local name=$1 set=$2 from=$3; shift 3
    local begin=()
    if test -f "$OUT/$name/last.safetensors"; then
        begin=(--resume)
    elif test "$from" != -; then
        begin=(--init "$OUT/$from/last.safetensors")
    fi
    "$HYDROGRAD" train --data "$OUT/$set" --threads "$THREADS" "${begin[@]}" --set ema=0.999 --set validation_windows=20 --out "$OUT/$name" "$@"
}

# 200 walls over 6.6 time units each, and three times as many over 2.7: where the flow still adapts to its wall.
data long --trajectories 200/50/50
data many --trajectories 600/50/1 --frames 60 --seed 1

train first long - --steps 24000 --set model.rounds=10 --set learning_rate_steps=40000 --set noise=3e-4 --set temperature_weight=0.5 \
    --set validate_every=6000 --set "pushforward.after=[-1,3000,10000]" --set "pushforward.unrolls=[0,1,2]" --set "pushforward.odds=[3.0,1.0,1.0]"
train second long first --steps 24000 --set learning_rate=2.5e-4 --set learning_rate_steps=16000 --set noise=2e-4 --set temperature_weight=0.5 \
    --set validate_every=6000 --set "pushforward.after=[-1,0,1,2,3]" --set "pushforward.unrolls=[0,1,2,4,8]" \
    --set "pushforward.odds=[3.0,1.0,1.0,1.0,0.5]"
train third long second --steps 15000 --set learning_rate=2.5e-4 --set learning_rate_steps=15000 --set noise=2e-5 --set temperature_noise=0.02 \
    --set temperature_weight=2.0 --set validate_every=2500 --set "pushforward.after=[-1,0,1,2]" --set "pushforward.unrolls=[0,1,2,4]" \
    --set "pushforward.odds=[4.0,1.0,1.0,1.0]"
train fourth many third --steps 20000 --set learning_rate=4e-4 --set learning_rate_steps=13000 --set noise=3e-5 --set temperature_noise=0.02 \
    --set temperature_weight=2.0 --set validate_every=4000 --set "pushforward.after=[-1,0,1,2,3]" --set "pushforward.unrolls=[0,1,2,4,8]" \
    --set "pushforward.odds=[4.0,1.0,1.0,1.0,0.5]"

"$HYDROGRAD" evaluate --model "$OUT/fourth/last.safetensors" --data "$OUT/long" --split test --threads "$THREADS" --out "$OUT/test"
cp "$OUT/fourth/last.safetensors" "$MODEL/model.safetensors"
cp "$OUT/fourth/curves.png" "$MODEL/curves.png"
echo "model and curves in $MODEL"

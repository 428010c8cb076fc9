#!/usr/bin/env bash
# From nothing to models/taylor-green: data, a training, evaluation, model and curves copied.
#
#   cargo build --release && scripts/train_taylor_green.sh
#   OUT=/tmp/vortices THREADS=2 scripts/train_taylor_green.sh
#
# HYDROGRAD  the program (default: target/release/hydrograd)
# OUT        folder of data set and training (default: runs/taylor-green); what is there already is gone on with
# THREADS    worker threads (default: 1); the parameters are the same with any number
# STEPS      updates (default: 40000, as the model that is there: a quarter of an hour of a core)
# MODEL      where model and curves go (default: models/taylor-green)
set -euo pipefail
cd "$(dirname "$0")/.."
HYDROGRAD=${HYDROGRAD:-target/release/hydrograd}
OUT=${OUT:-runs/taylor-green}
THREADS=${THREADS:-1}
STEPS=${STEPS:-40000}
MODEL=${MODEL:-models/taylor-green}
command -v "$HYDROGRAD" >/dev/null || { echo "train_taylor_green.sh: no $HYDROGRAD; cargo build --release, or name it in HYDROGRAD" >&2; exit 2; }
mkdir -p "$OUT" "$MODEL"

# 400 particles in a fresh disorder each, from the start on: frames of 0.025, a quarter of the time of LagrangeBench's recipe at this spacing, to t = 2.5.
test -f "$OUT/data/metadata.json" ||
    "$HYDROGRAD" generate taylor-green --trajectories 100/10/10 --frames 101 --every 25 --relax 0 --set resolution.dx=0.05 \
        --set method.name=standard --threads "$THREADS" --out "$OUT/data"

RESUME=()
if test -f "$OUT/train/last.safetensors"; then RESUME=(--resume); fi
# Two frames: places and velocities, which any start has.
"$HYDROGRAD" train --data "$OUT/data" --threads "$THREADS" "${RESUME[@]}" --steps "$STEPS" --out "$OUT/train" \
    --set features.frames=2 --set model.latent=32 --set model.rounds=5 --set ema=0.999 --set learning_rate=1e-3 --set learning_rate_steps=10000 \
    --set validate_every=1000 --set validation_steps=8 --set "pushforward.after=[-1,3000,8000]" --set "pushforward.unrolls=[0,1,3]" --set "pushforward.odds=[3.0,1.0,1.0]"
"$HYDROGRAD" evaluate --model "$OUT/train/last.safetensors" --data "$OUT/data" --split test --steps 8 --threads "$THREADS" --out "$OUT/test"
cp "$OUT/train/last.safetensors" "$MODEL/model.safetensors"
cp "$OUT/train/curves.png" "$MODEL/curves.png"
echo "model and curves in $MODEL"

#!/usr/bin/env bash
# `hydrograd slurm` on a real Slurm: starts the cluster of cluster.sh, submits a data set of four tasks, maps of stability, a study, two
# validations and a search from all starts, each with the job that puts its shares together; tells tasks to stop, which are requeued
# and go on; and compares what came of it with one process. A run that is cancelled stays so. About three minutes; as root, like
# cluster.sh. HYDROGRAD names another program than target/release/hydrograd.
set -euo pipefail
cd "$(dirname "$0")/../.."
cluster=$PWD/scripts/slurm/cluster.sh
hydrograd=${HYDROGRAD:-$PWD/target/release/hydrograd}
[ -x "$hydrograd" ] || { echo "try.sh: no program $hydrograd: cargo build --release" >&2; exit 2; }
home=$(mktemp -d)
# Munge wants its socket where everybody may ask.
chmod 755 "$home"
export HYDROGRAD_SLURM=$home/cluster
export SLURM_CONF=$HYDROGRAD_SLURM/slurm.conf
trap '"$cluster" stop; rm -rf "$home"' EXIT
"$cluster" start
# With a space, as a test of the job files' quotes.
mkdir "$home/a study"
cd "$home/a study"

fail() {
    echo "FAILED: $1" >&2
    tail -n 30 ./*.log "$HYDROGRAD_SLURM"/slurmctld.log >&2
    exit 1
}

# Waits (at most so many tenths of a second) until a command succeeds.
await() {
    local tenths=$1
    shift
    for _ in $(seq "$tenths"); do
        "$@" >/dev/null 2>&1 && return 0
        sleep 0.1
    done
    fail "not within $((tenths / 10)) s: $*"
}
gone() { [ -z "$(squeue --noheader --job "$1" 2>/dev/null)" ]; }
has() { grep -qs "$1" "$2"; }
state() { squeue --noheader --job "$1" --format %T 2>/dev/null; }
is() { [ "$(state "$1")" = "$2" ]; }

# Writes the jobs of a command and submits them by the line that is printed; their numbers are in $array and $merge.
submit() {
    local line
    "$hydrograd" slurm "$@" | tee said
    line=$(sed -n 's/^next: //p' said)
    [[ $line == job=* ]] || fail "no line to submit"
    merge=$(eval "${line/sbatch --dependency/sbatch --parsable --dependency}; echo \$job >array")
    array=$(cat array)
}

# Asks a job to stop. Once: scancel would send it again while the job is on its way into the queue, and to its next start.
tell() { timeout 1 scancel --signal=TERM --batch "$1" || true; }
# Waits until the array has ended and its shares are put together.
together() {
    await 6000 gone "$array"
    await 3000 gone "$merge"
    [ -e "$1-merge-$merge.log" ] || fail "the shares were not put together"
}

# Files of both that have the same bytes.
same() {
    local name
    for name in "$@"; do
        diff -q "whole/$name" "shares/$name" >/dev/null || fail "$name differs from that of one process"
    done
    echo "the same bytes as of one process: $*"
}
without_seconds() {
    python3 - "$@" <<'END'
import csv, sys
names = [row for row in csv.reader(open(sys.argv[1]))]
kept = [k for k, name in enumerate(names[0]) if "seconds" not in name]
print([[row[k] for k in kept] for row in names])
END
}

echo "== a data set of four tasks; one is told to stop"
set_of=(generate heated-channel --trajectories 12/2/2 --frames 147)
submit --tasks 4 --out generate.sh "${set_of[@]}" --out shares
task=${array}_0
await 300 is "$task" RUNNING
# It has made a trajectory, and is at work at another one.
await 600 test -e shares/parts/train-00000.h5
tell "$task"
log=generate-$task.log
await 300 has 'stopped by SIGTERM' "$log"
await 300 is "$task" PENDING
squeue
together generate
grep -E '^(==|stopped|SIGTERM)|kept from before' "$log"
grep -q ', start 1:' "$log" || fail "the task was not started again"
grep -q '[1-9][0-9]* kept from before' "$log" || fail "the task began anew"
"$hydrograd" "${set_of[@]}" --out whole --threads 2 >/dev/null
same train.h5 valid.h5 test.h5 metadata.json
rm -rf shares whole

echo "== maps of stability"
maps=(stress taylor-green --quick)
submit --tasks 3 --out stress.sh "${maps[@]}" --out shares
together stress
"$hydrograd" "${maps[@]}" --out whole --threads 2 >/dev/null
[ "$(without_seconds whole/stress.csv)" = "$(without_seconds shares/stress.csv)" ] || fail "stress.csv differs"
same taylor-green-step.png
rm -rf shares whole

echo "== a study"
"$hydrograd" generate heated-channel --trajectories 3/1/1 --frames 12 --skip 20 --set resolution.dx=0.025 --out data >/dev/null
study=(study --data data --grid noise=1e-3,1e-4,1e-5,1e-6 --steps 60 --set model.latent=16 --set model.rounds=2
    --set validation_steps=2 --set validation_windows=1)
submit --tasks 2 --out study.sh "${study[@]}" --out shares
together study
"$hydrograd" "${study[@]}" --out whole --threads 1 >/dev/null
[ "$(without_seconds whole/study.csv)" = "$(without_seconds shares/study.csv)" ] || fail "study.csv differs"
echo "the same table as of one process, but for seconds"
rm -rf shares whole

echo "== cases with a known answer"
cases=(validate --quick --filter poiseuille)
"$hydrograd" slurm --submit --out validate.sh "${cases[@]}" --out shares | tee said
read -r array merge < <(sed -n 's/^jobs: \(.*\) and then \(.*\)/\1 \2/p' said)
together validate
"$hydrograd" "${cases[@]}" --out whole --threads 2 >/dev/null
[ "$(without_seconds whole/validation.csv)" = "$(without_seconds shares/validation.csv)" ] || fail "validation.csv differs"
same errors.png
rm -rf shares whole

echo "== all starts; a search is told to stop"
starts=(optimize --start all --no-verify --epochs 12 --set optimise.method=adam)
submit --out starts.sh "${starts[@]}" --out shares
task=${array}_1
await 600 test -e shares/random/checkpoint.safetensors
tell "$task"
await 300 is "$task" PENDING
together starts
grep -E '^(==|stopped)' "starts-$task.log"
"$hydrograd" "${starts[@]}" --out whole --threads 1 >/dev/null
same starts.png walls.png {flat,random,linear,sine}/shape.csv {flat,random,linear,sine}/state.h5
rm -rf shares whole

echo "== a run of an hour that is cancelled stays so; one that is told goes on"
"$hydrograd" slurm --out long.sh simulate --set time.end=4000 --set output.frames=0 --out long | tee said
job=$(sbatch --parsable long.sh)
await 300 test -e long/history.csv
tell "$job"
await 300 is "$job" PENDING
await 300 is "$job" RUNNING
await 100 has 'start 1: .*--resume long' "long-$job.log"
sleep 2
scancel "$job"
await 600 gone "$job"
sleep 8
gone "$job" || fail "a cancelled job came back"
grep -E '^(==|stopped)' "long-$job.log"

echo "== what failed is not put together"
printf '#!/bin/bash\n#SBATCH --array=0-1\nexit 1\n' >fail.sh
array=$(sbatch --parsable fail.sh)
merge=$(sbatch --parsable --dependency=afterok:"$array" generate-merge.sh)
await 600 gone "$merge"
[ ! -e "generate-merge-$merge.log" ] || fail "it was put together"
echo "PASSED"

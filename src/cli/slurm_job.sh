
echo "== $(date -u +%FT%TZ) job $job, start ${SLURM_RESTART_COUNT:-0}: $*"
# SIGTERM comes before the time limit: hydrograd keeps what there is and ends with 143.
trap '{forward}' TERM
"$@" &
child=$!
wait "$child"
code=$?
# A signal ends `wait`, and not yet the command.
while kill -0 "$child" 2>/dev/null; do
    wait "$child"
    code=$?
done
# Queued again, unless it was cancelled (then it is not RUNNING any more) or does not get on.
if [ "$code" = 143 ] && [ "$(squeue --noheader --job "$job" --format %T)" = RUNNING ] &&
    [ "${SLURM_RESTART_COUNT:-0}" -lt {most_restarts} ]; then
    scontrol requeue "$job"
fi
exit "$code"

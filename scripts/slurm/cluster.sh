#!/usr/bin/env bash
# A Slurm cluster of one node on this host, to try job files on: munge, slurmctld and slurmd of Debian's packages, without systemd,
# without a database, with files, keys and logs in a folder of their own. As root:
#
#   apt-get install slurmctld slurmd slurm-client munge
#   scripts/slurm/cluster.sh start
#   export SLURM_CONF=/tmp/hydrograd-slurm/slurm.conf      # then sbatch, squeue and scancel
#   scripts/slurm/cluster.sh status
#   scripts/slurm/cluster.sh stop
#
# HYDROGRAD_SLURM names another folder; two clusters at once need other ports, too (HYDROGRAD_SLURM_PORT, 26817 and the next).
set -euo pipefail
folder=${HYDROGRAD_SLURM:-/tmp/hydrograd-slurm}
port=${HYDROGRAD_SLURM_PORT:-26817}
export SLURM_CONF=$folder/slurm.conf

fail() {
    echo "cluster.sh: $1" >&2
    exit "${2:-1}"
}

# Ends what a file names, if that is still running.
end() {
    local number
    number=$(cat "$1" 2>/dev/null) || return 0
    kill "$number" 2>/dev/null || return 0
    for _ in $(seq 100); do
        kill -0 "$number" 2>/dev/null || return 0
        sleep 0.1
    done
    kill -KILL "$number" 2>/dev/null || true
}

write_configuration() {
    local host memory
    host=$(hostname -s)
    memory=$(($(sed -n 's/^MemTotal: *\([0-9]*\) kB/\1/p' /proc/meminfo) / 1024))
    # No control groups: containers often have none to write to. A requeued job waits as long as a credential lives (cred_expire, two
    # minutes otherwise).
    cat >"$SLURM_CONF" <<END
ClusterName=hydrograd
SlurmctldHost=$host(127.0.0.1)
SlurmctldPort=$port
SlurmdPort=$((port + 1))
SlurmUser=root
AuthType=auth/munge
AuthInfo=socket=$folder/munge/socket,cred_expire=5
StateSaveLocation=$folder/state
SlurmdSpoolDir=$folder/spool
SlurmctldPidFile=$folder/slurmctld.pid
SlurmdPidFile=$folder/slurmd.pid
SlurmctldLogFile=$folder/slurmctld.log
SlurmdLogFile=$folder/slurmd.log
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
SelectType=select/cons_tres
SelectTypeParameters=CR_CPU
SlurmdParameters=config_overrides
JobRequeue=1
KillWait=20
MpiDefault=none
ReturnToService=2
SchedulerParameters=sched_interval=2,bf_interval=2
NodeName=$host NodeAddr=127.0.0.1 CPUs=2 RealMemory=$memory State=UNKNOWN
PartitionName=main Nodes=ALL Default=YES MaxTime=INFINITE State=UP
END
}

start() {
    [ "$(id -u)" = 0 ] || fail "has to run as root" 2
    for tool in munged slurmctld slurmd sinfo; do
        command -v "$tool" >/dev/null || fail "$tool is not installed: apt-get install slurmctld slurmd slurm-client munge" 2
    done
    if is_up; then
        fail "a cluster is up in $folder already" 2
    fi
    rm -rf "$folder"
    mkdir -p "$folder"/{state,spool}
    # Everybody may ask munge; nobody else may read its key.
    mkdir -m 755 "$folder/munge"
    (umask 077 && head -c 128 /dev/urandom >"$folder/munge/key")
    munged --key-file="$folder/munge/key" --socket="$folder/munge/socket" --pid-file="$folder/munge/pid" \
        --log-file="$folder/munge/log" --seed-file="$folder/munge/seed"
    write_configuration
    slurmctld
    slurmd
    for _ in $(seq 100); do
        is_up && break
        sleep 0.2
    done
    is_up || fail "the node is not up after 20 s: see $folder/slurmctld.log and $folder/slurmd.log"
    echo "export SLURM_CONF=$SLURM_CONF"
}

is_up() {
    [ -e "$SLURM_CONF" ] && sinfo -h -o %t 2>/dev/null | grep -qE '^(idle|mix|alloc|comp)'
}

stop() {
    # Jobs that run are cancelled first: nobody would look after them.
    scancel --user="$(id -un)" 2>/dev/null || true
    for _ in $(seq 50); do
        [ -z "$(squeue -h 2>/dev/null)" ] && break
        sleep 0.2
    done
    for pid in "$folder/slurmd.pid" "$folder/slurmctld.pid" "$folder/munge/pid"; do
        end "$pid"
    done
}

case ${1:-} in
start) start ;;
stop) stop ;;
status)
    [ -e "$SLURM_CONF" ] || fail "no cluster was started in $folder"
    sinfo
    squeue
    ;;
*) fail "start, stop or status?" 2 ;;
esac

# Slurm on this machine alone: two nodes of one core each. To be sourced by a script that takes the program to test as its first
# argument, and has set `name`. Sets `antirad` and `folder`; everything that is started here ends with the script. Needs root and
# Debian's packages slurm-wlm and munge; without them the script ends, with 0.
export PATH="$PATH:${CARGO_HOME:-${HOME:-}/.cargo}/bin:/usr/sbin:/sbin"
exec </dev/null

say() { printf '%s: %s\n' "$name" "$*"; }
fail() {
    printf '%s: FAILED: %s\n' "$name" "$*" >&2
    tail -n 3 "$folder"/log/slurm*d* >&2 || true
    exit 1
}
for tool in slurmctld slurmd sbatch scontrol munged; do
    if ! command -v "$tool" >/dev/null || [[ $(id -u) != 0 ]]; then
        say "SKIPPED: it needs root, and $tool (apt install slurm-wlm munge)" >&2
        exit 0
    fi
done
if (($#)); then
    antirad=$(realpath "$1")
else
    cargo build --locked --release --bin antirad
    antirad=$PWD/target/release/antirad
fi

# Munge wants folders that only their owner can change, all the way up.
folder=$(mktemp -d /run/antirad-slurm-XXXXXX)
daemons=()
cleanup() {
    status=$?
    trap - EXIT INT TERM
    scancel --user=root 2>/dev/null || true
    sleep 1
    for ((k = ${#daemons[@]} - 1; k >= 0; k--)); do
        kill "${daemons[k]}" 2>/dev/null || true
        wait "${daemons[k]}" 2>/dev/null || true
    done
    rm -rf "$folder"
    exit "$status"
}
trap cleanup EXIT
trap 'exit 130' INT TERM

mkdir -p "$folder"/{log,state,munge,node1,node2,work/jobs}
chmod 755 "$folder" "$folder/munge"
head -c 1024 /dev/urandom >"$folder/munge.key"
chmod 400 "$folder/munge.key"
munged --foreground --key-file="$folder/munge.key" --socket="$folder/munge/socket" --pid-file="$folder/munge/pid" \
    --log-file="$folder/log/munged" --seed-file="$folder/munge/seed" 2>"$folder/log/munged.error" &
daemons+=($!)
cat >"$folder/slurm.conf" <<END
ClusterName=antirad
SlurmctldHost=localhost(127.0.0.1)
SlurmctldPort=26817
SlurmUser=root
AuthType=auth/munge
CredType=cred/munge
AuthInfo=socket=$folder/munge/socket,cred_expire=5
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core
JobAcctGatherType=jobacct_gather/none
AccountingStorageType=accounting_storage/none
SwitchType=switch/none
MpiDefault=none
ReturnToService=2
KillWait=10
StateSaveLocation=$folder/state
SlurmctldPidFile=$folder/slurmctld.pid
SlurmctldLogFile=$folder/log/slurmctld
SlurmdPidFile=$folder/%n/slurmd.pid
SlurmdSpoolDir=$folder/%n
SlurmdLogFile=$folder/log/slurmd-%n
NodeName=node1 NodeAddr=127.0.0.1 NodeHostname=$(hostname) Port=26818 CPUs=1 RealMemory=1024
NodeName=node2 NodeAddr=127.0.0.1 NodeHostname=$(hostname) Port=26819 CPUs=1 RealMemory=1024
PartitionName=all Nodes=node1,node2 Default=YES MaxTime=INFINITE State=UP
END
export SLURM_CONF=$folder/slurm.conf
slurmctld -D -f "$SLURM_CONF" 2>"$folder/log/slurmctld.error" &
daemons+=($!)
for node in node1 node2; do
    slurmd -D -N "$node" -f "$SLURM_CONF" 2>"$folder/log/slurmd-$node.error" &
    daemons+=($!)
done
# Until something holds, for at most this many seconds.
until_true() {
    local left=$1
    shift
    until "$@" >/dev/null 2>&1; do
        ((left-- > 0)) || fail "this did not come true: $*"
        sleep 1
    done
}
idle_nodes() { [[ $(sinfo --noheader --Node --format=%T | grep -c '^idle$') == 2 ]]; }
until_true 60 idle_nodes
say "$(sinfo --version) with two nodes"

# How far the jobs in `out` are, and the tasks of an array.
status() { "$antirad" status out 2>/dev/null || true; }
done_jobs() { status | grep -c ' finished '; }
at_least() { (($(done_jobs) >= $1)); }
# Ends the process of a job that runs, as its status tells; or requeues a task that does. Of the node that is named, if one is.
victim=
killed() {
    for victim in $(status | sed -n 's/.* running .*process \([0-9]*\) on .*/\1/p' | sort -u | shuf); do
        if tr '\0' '\n' <"/proc/$victim/environ" 2>/dev/null | grep -qx "SLURMD_NODENAME=${1:-.*}"; then
            kill -KILL "$victim"
            return
        fi
    done
    return 1
}
requeued() {
    local task
    task=$(squeue --noheader --array --states=RUNNING ${1:+"--nodelist=$1"} --format=%K | shuf -n 1)
    [[ -n $task ]] && scontrol requeue "${array}_$task"
}
over() { [[ -z $(squeue --noheader --jobs="$array" 2>/dev/null) ]]; }

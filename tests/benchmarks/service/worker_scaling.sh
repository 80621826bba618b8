#!/bin/bash
# How throughput grows from one worker to two, and what the scheduler takes of it: 450 trajectories in 30 tasks
# and 16 chains of identification, on a real coordinator and real workers of one slot, each on a core of its own.
#
#   tests/benchmarks/service/worker_scaling.sh BIN [ROUNDS]     from the source tree; BIN holds realitygrad
#
# One line per job and number of workers: the time from the first task's start to the last one's end, the
# tasks' own time, the share of the workers' time that is not theirs, from the first start to each one's last end
# (leasing, fetching, uploading, committing), and the share in which there was no task left for one of them.
# One line per round and job: how much faster two workers were. Other work on the machine shows in both.
set -euo pipefail
bin=$(realpath "$1")
rounds=${2:-3}
cores=$(nproc)
folder=$(mktemp -d)
pids=()
trap 'kill "${pids[@]}" 2>/dev/null; wait; rm -rf "$folder"' EXIT

# One iteration leaves a model and a recording to identify from.
"$bin/realitygrad" run --iterations 1 --workers 2 --identify-seconds 5 --dir "$folder/run" >"$folder/run.log" 2>&1 ||
  { cat "$folder/run.log"; exit 1; }

# Of a stage's tasks: time from the first start to the last end, the sum over workers of that to each one's last
# end, the tasks' own. A task's keys come in alphabetical order.
tasks_of() {
  awk -v stage="\"$1\"," '
    function seconds(stamp) { split(substr(stamp, 13), part, ":"); return part[1] * 3600 + part[2] * 60 + part[3] }
    /"finished":/ { finished = seconds($2) }
    /"stage":/ { ours = $2 == stage }
    /"started":/ && ours {
      started = seconds($2)
      if (finished < started) finished += 86400
      if (first == "" || started < first) first = started
    }
    /"seconds":/ && ours { own += $2 }
    /"worker":/ && ours {
      if (finished > last) last = finished
      if (finished > ends[$2]) ends[$2] = finished
    }
    END { for (w in ends) busy += ends[w] - first; print last - first, busy, own }' "$2"
}

measure() {  # WORKERS NAME STAGE SUBMIT-ARGUMENTS…: prints what tasks_of does
  local workers=$1 name=$2 stage=$3
  shift 3
  local at=$folder/$name.$workers
  rm -rf "$at" && mkdir "$at" && cp "$folder/run/realitygrad.db" "$at/"
  export REALITYGRAD_COORDINATOR=ipc://$at/socket
  "$bin/realitygrad-coordinator" --listen "$REALITYGRAD_COORDINATOR" --db "$at/realitygrad.db" >"$at/log" 2>&1 &
  pids=($!)
  for k in $(seq "$workers"); do
    taskset -c $((cores - k)) "$bin/realitygrad-worker" --name "w$k" -j 1 --folder "$at/w$k" >>"$at/log" 2>&1 &
    pids+=($!)
  done
  sleep 1
  "$bin/realitygrad" submit "$@" --wait --output json >"$at/submitted" 2>>"$at/log" || { cat "$at/log"; exit 1; }
  "$bin/realitygrad" job show "$(awk '/^  "id":/ { print +$2 }' "$at/submitted")" \
    --output json >"$at/job"
  kill "${pids[@]}" 2>/dev/null || true
  wait "${pids[@]}" 2>/dev/null || true
  tasks_of "$stage" "$at/job"
}

for round in $(seq "$rounds"); do
  for job in trajectories identification; do
    arguments=(trajectories --trajectories 450)
    [ $job = identification ] && arguments=(identify --identify-seconds 0 --hops 1 --chains 16 --rounds 1)
    times=()
    for workers in 1 2; do
      read -r wall busy own <<<"$(measure $workers $job $job "${arguments[@]}")"
      awk -v j=$job -v w=$workers -v t="$wall" -v b="$busy" -v o="$own" 'BEGIN {
        printf "%-14s %d workers %6.2f s, tasks %6.2f s, scheduling %3.1f %%, idle at the end %3.1f %%\n", \
          j, w, t, o, 100 * (1 - o / b), 100 * (1 - b / (w * t)) }'
      times+=("$wall")
    done
    awk -v r="$round" -v j=$job -v a="${times[0]}" -v b="${times[1]}" 'BEGIN {
      printf "%-14s round %d: two workers are %.2f x as fast\n", j, r, a / b }'
  done
done

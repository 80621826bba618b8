# How a build goes, on stderr: how much is done and about how long the rest takes. Sourced, not run.
#
#   ninja -C FOLDER … 2>&1 | show_progress TITLE "$(build_plan FOLDER …)" CORES
#
# On a terminal one line that redraws itself, elsewhere a line every tenth. A job counts as much as build_costs
# says of its target, so that few slow jobs do not mislead; the time left follows the pace so far, and at first
# the pace that build_costs was measured at. What is no status line of ninja (an error, a warning) is passed on.

costs_file=${BASH_SOURCE[0]%/*}/build_costs

now_ms() { local t=${EPOCHREALTIME/[.,]/}; echo $((t / 1000)); }

# build_plan FOLDER [targets…]: what ninja will do, as its status lines. `ninja -n` on build.ninja itself stops at the
# globs that CMake checks first, and knows of none of the jobs behind them; a copy of it is not checked.
build_plan() {
  local folder=$1; shift
  cp "$folder/build.ninja" "$folder/plan.ninja"
  ninja -C "$folder" -f plan.ninja -n "$@"
}

# next_line TEXT_VARIABLE: true with a line, 1 at the end, more than 128 when none came for a second.
next_line() { IFS= read -r -t 1 "$1"; }

# Fills cost_of[TARGET] with tenths of a second per object.
read_costs() {
  local cost target
  declare -gA cost_of=()
  while read -r cost target; do
    case $cost in '' | '#'*) ;; *) cost_of[$target]=$((10 * cost)) ;; esac
  done <"$costs_file"
}

# job_cost DESCRIPTION: sets job_tenths. Everything but compiling takes no time worth counting.
job_cost() {
  job_tenths=1
  case $1 in
    *'Building CXX object '*)
      local target=${1##*CMakeFiles/}
      target=${target%%.dir/*}
      job_tenths=${cost_of[$target]:-${cost_of[other]}}
      ;;
  esac
}

duration_text() {  # whole seconds
  if [ "$1" -lt 60 ]; then echo "$1 s"; else echo "$(($1 / 60)) min $(($1 % 60)) s"; fi
}

# seconds_left DONE TOTAL ELAPSED_MS CORES: DONE and TOTAL in tenths of a second.
seconds_left() {
  local done=$1 total=$2 elapsed=$3 cores=$4
  local trust=100  # tenths of work at the measured pace that count as seen
  echo $(((total - done) * (elapsed + trust * 100 / cores) / (done + trust) / 1000))
}

show_progress() {
  local title=$1 plan=$2 cores=$3
  local line rest total=0 done=0 jobs=0 tenth=0 start part='' text status is_terminal=false
  [ -t 2 ] && is_terminal=true
  read_costs
  while IFS= read -r line; do
    [[ $line == '['*']'* ]] || continue
    job_cost "$line"
    total=$((total + job_tenths)) jobs=$((jobs + 1))
  done <<<"$plan"
  start=$(now_ms)
  while true; do
    status=0
    next_line line || status=$?
    [ "$status" = 1 ] && [ -z "$line" ] && break
    if [ "$status" -gt 128 ]; then
      part+=$line
    else
      line=$part$line part=''
      case $line in
        '['*/*']'*) job_cost "$line"; done=$((done + job_tenths)) ;;
        'ninja: Entering directory'* | 'ninja: no work to do.') continue ;;
        *) $is_terminal && printf '\r\033[K' >&2; printf '%s\n' "$line" >&2 ;;
      esac
    fi
    [ "$jobs" -gt 0 ] || continue
    [ "$done" -gt "$total" ] && total=$done
    rest=$(seconds_left "$done" "$total" $(($(now_ms) - start)) "$cores")
    text="$title: $((100 * done / total)) %, about $(duration_text "$rest") left"
    if $is_terminal; then
      printf '\r\033[K%s' "$text" >&2
    elif [ $((10 * done / total)) -gt "$tenth" ] && [ "$done" -lt "$total" ]; then
      tenth=$((10 * done / total))
      printf '%s\n' "$text" >&2
    fi
  done
  $is_terminal && printf '\r\033[K' >&2
  [ "$jobs" = 0 ] || printf '%s: took %s\n' "$title" "$(duration_text $((($(now_ms) - start) / 1000)))" >&2
}

# Shared by deploy/check and deploy/quickstart: packages and build. Sourced, not run.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
source deploy/progress.sh

say() { printf '\n== %s\n' "$*" >&2; }

as_root() {
  if [ "$(id -u)" = 0 ]; then "$@"; elif command -v sudo >/dev/null; then sudo "$@"
  else echo "deploy: needs root or sudo to install packages: $*" >&2; exit 1; fi
}

# install_packages [with-tests] [with-fuzzing]: installs what is missing of deploy/packages; no network if nothing is.
install_packages() {
  local wanted missing=() kinds=()
  case " $* " in *" with-tests "*) kinds+=(-e 's/^test://');; esac
  case " $* " in *" with-fuzzing "*) kinds+=(-e 's/^fuzz://');; esac
  wanted=$(sed "${kinds[@]}" -e '/^[a-z]*:/d' deploy/packages)
  for package in $(grep -v '^#' <<<"$wanted"); do
    dpkg-query -W -f='${Status}' "$package" 2>/dev/null | grep -q 'install ok installed' || missing+=("$package")
  done
  [ ${#missing[@]} = 0 ] && return 0
  say "installing ${#missing[@]} packages: ${missing[*]}"
  as_root env DEBIAN_FRONTEND=noninteractive apt-get update -qq
  as_root env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "${missing[@]}" >/dev/null
}

# How many compilers at once: one per core, but 1.7 GB of memory for each: the largest units take that.
build_jobs() {
  local cores fit
  cores=$(nproc)
  fit=$(awk '/^MemAvailable:/ {print int($2 / 1700000)}' /proc/meminfo)
  [ "$fit" -lt 1 ] && fit=1
  echo $((fit < cores ? fit : cores))
}

# build PRESET [cmake options… -- targets…]: shows how it goes, and the compiler's own words when something is wrong.
build() {
  local preset=$1 jobs; shift
  local options=() ; while [ $# -gt 0 ] && [ "$1" != -- ]; do options+=("$1"); shift; done
  [ "${1:-}" = -- ] && shift
  jobs=$(build_jobs)
  say "building ($preset, $jobs at a time)${*:+: $*}"
  cmake --preset "$preset" "${options[@]}" >/dev/null
  ninja -C "build/$preset" -j "$jobs" "$@" 2>&1 | show_progress building "$(build_plan "build/$preset" "$@")" "$jobs"
}

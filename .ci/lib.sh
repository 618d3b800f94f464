# Shared by the scripts of this folder: timed steps, a table of them at the end, and tools that are installed once.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

ci_logs=$(mktemp -d)
ci_table=$ci_logs/table
ci_began=$SECONDS

# step NAME COMMAND...: runs the command and notes its seconds. The first failure ends the script.
step() {
  local name=$1 began=$SECONDS
  shift
  printf '\n== %s\n' "$name"
  "$@"
  printf '%6d s  %s\n' $((SECONDS - began)) "$name" >>"$ci_table"
}

# skip NAME REASON: notes in the table that a step was left out.
skip() {
  printf '\n== %s: skipped, %s\n' "$1" "$2"
  printf 'skipped  %s: %s\n' "$1" "$2" >>"$ci_table"
}

# Prints the seconds of every step, and last what the test runner said.
finish() {
  local status=$?
  printf '\n== seconds\n'
  cat "$ci_table" 2>/dev/null || true
  printf '%6d s  total\n' $((SECONDS - ci_began))
  grep -h 'Summary \[' "$ci_logs"/*.tests 2>/dev/null | sed 's/^ *//' || true
  rm -rf "$ci_logs"
  exit "$status"
}
trap finish EXIT

tools() {
  for component in rustfmt clippy; do
    rustup component list --installed 2>/dev/null | grep -q "^$component" || rustup component add "$component"
  done
  command -v cc >/dev/null || { apt-get update -q && apt-get install -y -q gcc libc6-dev; }
  command -v cargo-nextest >/dev/null || cargo install --locked cargo-nextest
  rustc --version
}

# installed PROGRAM: whether it is there, after an attempt to install the package of its name.
installed() {
  command -v "$1" >/dev/null && return
  if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
    (apt-get update -qq && DEBIAN_FRONTEND=noninteractive timeout 300 apt-get install -y -qq "$1") >/dev/null 2>&1 || true
  fi
  command -v "$1" >/dev/null
}

# postgresql: whether its programs are there, after an attempt to install them. Tests start servers of their own.
postgresql() {
  local initdb
  for attempt in 1 2; do
    for initdb in "$(command -v initdb)" /usr/lib/postgresql/*/bin/initdb; do
      [ ! -x "$initdb" ] || return 0
    done
    [ "$attempt" = 2 ] || installed postgresql || true
  done
  return 1
}

# python_packages: whether there is a Python with the packages of the tests, after an attempt to make one.
python_packages() {
  [ -z "${READERS_PYTHON:-}" ] || return 0
  local folder=target/python
  if ! "$folder/bin/python" -c "import mcap, moto.server, plyfile, pycolmap" 2>/dev/null; then
    python3 -m venv "$folder" && "$folder/bin/pip" install --quiet -r cli/tests/requirements.txt || return 1
  fi
  READERS_PYTHON=$PWD/$folder/bin/python
  export READERS_PYTHON
}

# Recordings to test with: not in the repository. Tests that need them are ignored where they are absent.
if [ -z "${MONOSLAM_DATA:-}" ] && [ -d ../shared/data ]; then
  MONOSLAM_DATA=$(cd ../shared/data && pwd)
  export MONOSLAM_DATA
fi

# ignored_because REASON: a filter expression for the tests ignored for a reason that begins so.
ignored_because() {
  git ls-files '*.rs' | xargs awk -v reason="#[ignore = \"$1" '
    index($0, reason) { wanted = 1; next }
    wanted && match($0, /fn [a-z0-9_]+/) {
      printf "%stest(/(^|::)%s$/)", separator, substr($0, RSTART + 3, RLENGTH - 3)
      separator = " + "; wanted = 0
    }
    END { if (!separator) printf "none()" }'
}

# run_tests LOG FILTER ARGUMENT...: what the filter selects; the arguments say whether ignored tests are among it.
run_tests() {
  local log=$ci_logs/$1.tests filter=$2
  shift 2
  cargo nextest run --workspace --locked -E "$filter" "$@" 2>&1 | tee "$log"
}

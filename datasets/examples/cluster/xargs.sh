#!/bin/bash
# Runs a spec with worker processes on this machine, wave by wave, and then publishes the tables.
#     WORKERS=4 bash xargs.sh SPEC STORE
set -eu -o pipefail
spec=$1 store=$2 workers=${WORKERS:-2}
tasks=$(mktemp)
trap 'rm -f "$tasks"' EXIT
while magline tasks "$spec" --set "store=$store" > "$tasks" && [ -s "$tasks" ]; do
  # The next wave repeats a unit without a result, up to three attempts. Exit status 123: a worker had such a unit.
  xargs -a "$tasks" -d '\n' -n 1 -P "$workers" magline task --store "$store" --threads 1 > /dev/null || [ $? = 123 ]
done
magline run "$spec" --set "store=$store"

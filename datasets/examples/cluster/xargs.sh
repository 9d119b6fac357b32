#!/bin/bash
# Runs a spec by worker processes of this machine: wave by wave, then the driver publishes.
#     WORKERS=4 bash xargs.sh SPEC STORE
set -eu -o pipefail
spec=$1 store=$2 workers=${WORKERS:-2}
tasks=$(mktemp)
trap 'rm -f "$tasks"' EXIT
while magline tasks "$spec" --set "store=$store" > "$tasks" && [ -s "$tasks" ]; do
  # A unit without an answer is given again in the next wave, until it is given up. Exit status 123: some worker had one such.
  xargs -a "$tasks" -d '\n' -n 1 -P "$workers" magline task --store "$store" --threads 1 > /dev/null || [ $? = 123 ]
done
magline run "$spec" --set "store=$store"

#!/bin/bash
# Runs a spec on a Slurm cluster. A job plans a wave, an array of jobs computes it, and the next job plans the next
# wave. The last plan job publishes the tables. All jobs need access to the same folder.
#     WORKERS=32 bash slurm.sh SPEC STORE
# The jobs run this file too. Add the options that your cluster requires to the two calls of `sbatch`: --time, --mem,
# --cpus-per-task, --partition, --account. `--time` ends a unit that hangs; after three attempts, the unit fails.
set -eu -o pipefail
spec=$1 store=$2 step=${3:-submit} tasks=${4:-}
workers=${WORKERS:-8}
here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)/slurm.sh
# Slurm copies the script of a job to another folder, so the jobs get its path in a variable.
script=${MAGLINE_SCRIPT:-$here}
plan() {
  sbatch --parsable --job-name=magline-plan --export=ALL,WORKERS="$workers",MAGLINE_SCRIPT="$script" "$@" \
    "$script" "$spec" "$store" plan
}

case $step in
  submit)
    plan
    ;;
  plan)
    tasks=$(pwd)/tasks-${SLURM_JOB_ID}.jsonl
    magline tasks "$spec" --set "store=$store" > "$tasks"
    if [ -s "$tasks" ]; then
      work=$(sbatch --parsable --job-name=magline-work --requeue --array=0-$((workers - 1)) \
        --export=ALL,WORKERS="$workers",MAGLINE_SCRIPT="$script" "$script" "$spec" "$store" work "$tasks")
      plan --dependency=afterany:"$work"
    else
      rm -f "$tasks"
      magline run "$spec" --set "store=$store"
    fi
    ;;
  work)
    magline task --store "$store" --share "$SLURM_ARRAY_TASK_ID/$SLURM_ARRAY_TASK_COUNT" \
      --threads "${SLURM_CPUS_PER_TASK:-1}" < "$tasks"
    ;;
esac

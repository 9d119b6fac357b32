"""Runs a spec on a Dask cluster.

    python dask_run.py SPEC STORE [SCHEDULER] [WORKERS]

Without a scheduler's address it starts workers on this machine. On Slurm, PBS, LSF, SGE or HTCondor make the cluster by
dask-jobqueue instead, for instance

    from dask_jobqueue import SLURMCluster
    cluster = SLURMCluster(cores=1, memory="4GB", walltime="02:00:00")
    cluster.adapt(maximum=64)

The store is a folder that all workers see, and `magline` is on their PATH. A worker that dies is replaced by Dask, and its
tasks are given to others; what it had finished is found in the store. Needs `distributed`.
"""

import subprocess
import sys

from dask.distributed import Client, LocalCluster, as_completed


def compute(task: str, store: str) -> tuple[int, str]:
    """Exit status and receipt of one task. A status of 1 means that some unit has no answer yet."""
    done = subprocess.run(
        ["magline", "task", "--store", store, "--threads", "1"], input=task, text=True, stdout=subprocess.PIPE
    )
    return done.returncode, done.stdout


def wave(spec: str, store: str) -> list[str]:
    """The tasks that can be computed now."""
    listed = subprocess.run(
        ["magline", "tasks", spec, "--set", f"store={store}"], text=True, stdout=subprocess.PIPE, check=True
    )
    return listed.stdout.splitlines()


def main(spec: str, store: str, scheduler: str | None, workers: int) -> int:
    cluster = scheduler or LocalCluster(n_workers=workers, threads_per_worker=1, dashboard_address=None)
    with Client(cluster) as client:
        # Units that were lost are listed again, until they are given up.
        while tasks := wave(spec, store):
            # The same task must be computed again when it is listed again.
            futures = client.map(compute, tasks, [store] * len(tasks), pure=False, retries=2)
            for future in as_completed(futures):
                if future.status == "error":
                    print(f"a task was lost: {future.exception()!r}", file=sys.stderr)
                elif future.result()[0] == 2:
                    return 2
    return subprocess.run(["magline", "run", spec, "--set", f"store={store}"]).returncode


if __name__ == "__main__":
    if len(sys.argv) < 3:
        sys.exit(__doc__)
    address = sys.argv[3] if len(sys.argv) > 3 and ":" in sys.argv[3] else None
    count = int(sys.argv[4]) if len(sys.argv) > 4 else 2
    sys.exit(main(sys.argv[1], sys.argv[2], address, count))

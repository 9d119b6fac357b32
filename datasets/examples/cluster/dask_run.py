"""Runs a spec on a Dask cluster.

    python dask_run.py SPEC STORE [SCHEDULER] [WORKERS]

Without the address of a scheduler, workers are started on this machine. On Slurm, PBS, LSF, SGE or HTCondor, create the
cluster with dask-jobqueue instead, for example

    from dask_jobqueue import SLURMCluster
    cluster = SLURMCluster(cores=1, memory="4GB", walltime="02:00:00")
    cluster.adapt(maximum=64)

The store must be a folder that all workers can access, and `magline` must be on their PATH. Dask replaces a worker that
stops and reassigns its tasks. Finished results are read from the store. Requires `distributed`.
"""

import subprocess
import sys

from dask.distributed import Client, LocalCluster, as_completed


def compute(task: str, store: str) -> tuple[int, str]:
    """Exit status and receipt of one task. A status of 1 means that some units have no result yet."""
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
        # Lost units are listed again until the maximum number of attempts.
        while tasks := wave(spec, store):
            # A task that is listed again must be computed again.
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

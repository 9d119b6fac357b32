"""Views of a store in a browser or a notebook."""

from __future__ import annotations

import atexit
import os
import subprocess
import sys
import threading
import webbrowser
from html import escape
from types import TracebackType

__all__ = ["View"]

START_S = 120.0
"""Time limit of the start, s. A store in an object store is listed first."""

END_S = 5.0
"""Time that the server has to end, s."""


class View:
    """Server of a store on the loopback interface of this machine. It ends with this process, or with `close`.

    A notebook shows the page in a frame. The frame is empty if the notebook's server and the browser are on different
    machines; in this case, forward the port under the same number.

    Parameters
    ----------
    store : path
        Folder of the store, or its address, such as ``s3://BUCKET/PREFIX``.
    height : int
        Height of the frame, px.

    Attributes
    ----------
    address : str
        Address of the page. It contains a secret token: whoever has it can read the store on this machine.

    Raises
    ------
    RuntimeError
        If the server does not start.

    Examples
    --------
    >>> import magline, tempfile
    >>> run = magline.run("datasets/examples/tolles_lawson.toml", store=tempfile.mkdtemp())
    >>> with magline.View(run.store.path) as view:
    ...     view.address.startswith("http://127.0.0.1:")
    True
    """

    def __init__(self, store: str | os.PathLike[str], *, height: int = 800) -> None:
        command = [sys.executable, "-m", "magline", "view", os.fspath(store)]
        # An interrupt of the notebook's kernel must not end the server.
        self._process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, start_new_session=True
        )
        atexit.register(self.close)
        self._height = height
        self._lines: list[str] = []
        self._started = threading.Event()
        threading.Thread(target=self._read, daemon=True).start()
        started = self._started.wait(START_S)
        found = [line for line in self._lines if line.startswith("http://127.0.0.1:")]
        if not started or not found:
            self.close()
            raise RuntimeError("\n".join(self._lines) or "the view has not started in time")
        self.address: str = found[0]

    def _read(self) -> None:
        """Read the messages of the server until it ends, so that it never waits for a reader."""
        for line in self._process.stderr or ():
            self._lines.append(line.rstrip("\n"))
            if line.startswith("http://"):
                self._started.set()
        self._started.set()

    def open(self) -> bool:
        """Open the page in a browser. Returns whether there is one."""
        return webbrowser.open(self.address)

    def close(self) -> None:
        """End the server."""
        atexit.unregister(self.close)
        if self._process.poll() is None:
            self._process.terminate()
            try:
                self._process.wait(END_S)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()

    def __enter__(self) -> View:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"<magline.View {self.address}>"

    def _repr_html_(self) -> str:
        return (
            f'<iframe src="{escape(self.address)}" width="100%" height="{int(self._height)}" '
            'style="border:0" title="magline view"></iframe>'
        )


def is_notebook() -> bool:
    """Whether this process is the kernel of a notebook."""
    ipython = sys.modules.get("IPython")
    shell = ipython.get_ipython() if ipython is not None else None
    return shell is not None and hasattr(shell, "kernel")

"""Packs the extension module of a cargo build as a wheel: ``python wheel.py LIBRARY FOLDER``.

For tests. A maturin build resolves the features of this package alone and compiles all dependencies again; this wheel
uses the library of the workspace's build. It has the same files, and is not stripped.
"""

import base64
import hashlib
import re
import sys
import sysconfig
import zipfile
from pathlib import Path

HERE = Path(__file__).parent


def field(pattern: str, file: Path) -> str:
    """First match of a pattern in a file."""
    found = re.search(pattern, file.read_text(), re.MULTILINE)
    if found is None:
        raise SystemExit(f"{file} does not contain {pattern}")
    return found.group(1)


def pack(library: Path, folder: Path) -> Path:
    """Write the wheel of a library to a folder and return its path."""
    version = field(r'^version = "(.*)"', HERE / "../../Cargo.toml")
    requires = field(r'^dependencies = \["(.*)"\]', HERE / "pyproject.toml")
    script = field(r'^magline = "(.*)"', HERE / "pyproject.toml")
    tag = "cp310-abi3-" + re.sub(r"[-.]", "_", sysconfig.get_platform())
    sources = [path for path in sorted((HERE / "magline").rglob("*")) if path.suffix in {".py", ".pyi", ".typed"}]
    files = {f"magline/{path.relative_to(HERE / 'magline')}": path.read_bytes() for path in sources}
    files["magline/py.typed"] = (HERE / "magline/py.typed").read_bytes()
    files["magline/_magline.abi3.so"] = library.read_bytes()
    info = f"magline-{version}.dist-info"
    required = "".join(f"Requires-Dist: {one}\n" for one in requires.split('", "'))
    metadata = f"Metadata-Version: 2.1\nName: magline\nVersion: {version}\n{required}"
    files[f"{info}/METADATA"] = (metadata + "Requires-Python: >=3.10\n").encode()
    files[f"{info}/WHEEL"] = f"Wheel-Version: 1.0\nRoot-Is-Purelib: false\nTag: {tag}\n".encode()
    files[f"{info}/entry_points.txt"] = f"[console_scripts]\nmagline = {script}\n".encode()
    files[f"{info}/RECORD"] = record(files, info).encode()
    wheel = folder / f"magline-{version}-{tag}.whl"
    with zipfile.ZipFile(wheel, "w") as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return wheel


def record(files: dict[str, bytes], info: str) -> str:
    """Table of the files with their hashes and sizes."""
    lines = []
    for name, content in files.items():
        digest = base64.urlsafe_b64encode(hashlib.sha256(content).digest()).rstrip(b"=").decode()
        lines.append(f"{name},sha256={digest},{len(content)}\n")
    return "".join(lines) + f"{info}/RECORD,,\n"


if __name__ == "__main__":
    print(pack(Path(sys.argv[1]), Path(sys.argv[2])))

"""Writes the licences of all third-party code and data in the program, and its software bill of materials.

``python third_party.py FEATURES LICENCES BILL``. The crates are those of a build on this platform without tests. The
bill is in the format CycloneDX 1.6. Fails for a crate without a licence, and for a vendored file without an entry.
"""

import json
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

# Files of a crate that hold its licence or a notice that must accompany copies.
STEMS = ("licen", "copying", "notice", "unlicense", "copyright")

# Folder of the files of others in the page, with their checksums.
VENDOR = Path("pipeline/report/src/html/web/vendor")
# Each file, its name and version, its licence, its source, and the file with the text of its licence.
VENDORED = [
    ("uPlot.iife.min.js", "uPlot", "1.6.32", "MIT", "https://github.com/leeoniya/uPlot", "uPlot.LICENSE"),
    ("flechette.min.js", "@uwdata/flechette", "2.4.0", "BSD-3-Clause", "https://github.com/uwdata/flechette",
     "flechette.LICENSE"),
    ("coastline.bin", "Natural Earth coastline 1:50m", "2024-01-24", "public domain",
     "https://www.naturalearthdata.com", None),
]


def metadata(features: str) -> dict[str, Any]:
    """Metadata of the workspace for this platform."""
    version = subprocess.run(["rustc", "-vV"], capture_output=True, check=True, text=True).stdout
    host = next(line.removeprefix("host: ") for line in version.splitlines() if line.startswith("host: "))
    command = ["cargo", "metadata", "--format-version", "1", "--filter-platform", host]
    command += ["--manifest-path", "pipeline/Cargo.toml", "--features", features]
    found: dict[str, Any] = json.loads(subprocess.run(command, capture_output=True, check=True).stdout)
    return found


def linked(found: dict[str, Any], root: str) -> list[dict[str, Any]]:
    """Packages that the program contains: dependencies that are not for tests."""
    nodes = {node["id"]: node for node in found["resolve"]["nodes"]}
    packages = {package["id"]: package for package in found["packages"]}
    seen, queue = set(), [next(p["id"] for p in found["packages"] if p["name"] == root)]
    while queue:
        package = queue.pop()
        if package in seen:
            continue
        seen.add(package)
        for dep in nodes[package]["deps"]:
            if any(kind["kind"] in (None, "build") for kind in dep["dep_kinds"]):
                queue.append(dep["pkg"])
    return sorted((packages[p] for p in seen), key=lambda p: (p["name"], p["version"]))


def licence_files(package: dict[str, Any]) -> list[Path]:
    """Files with the licence of a package."""
    folder = Path(package["manifest_path"]).parent
    files = [path for path in sorted(folder.iterdir()) if path.is_file() and path.name.lower().startswith(STEMS)]
    own = package["license_file"] and folder / package["license_file"]
    if own and own.is_file() and own not in files:
        files.append(own)
    return files


def licences(packages: list[dict[str, Any]]) -> str:
    """Licences of packages; equal texts appear once."""
    texts: dict[str, list[str]] = {}
    parts = ["magline contains the following crates, scripts and data.\n"]
    for package in packages:
        title = f"{package['name']} {package['version']}"
        licence = package["license"] or ""
        files = licence_files(package)
        if not licence and not files:
            raise SystemExit(f"{title} has no licence")
        source = package["repository"] or package["homepage"] or ""
        parts.append(f"{title}: {licence or 'see its text below'} {source}".rstrip())
        for path in files:
            texts.setdefault(path.read_text(errors="replace").strip(), []).append(title)
    for _, name, version, licence, source, file in VENDORED:
        parts.append(f"{name} {version}: {licence} {source}")
        if file:
            texts.setdefault((VENDOR / file).read_text().strip(), []).append(f"{name} {version}")
    for text, users in texts.items():
        parts.append(f"\n{'=' * 80}\n{', '.join(users)}\n{'=' * 80}\n{text}")
    return "\n".join(parts) + "\n"


def bill(packages: list[dict[str, Any]], root: str, checksums: dict[tuple[str, str], str]) -> dict[str, Any]:
    """Software bill of materials."""

    def component(package: dict[str, Any]) -> dict[str, Any]:
        name, version = package["name"], package["version"]
        found: dict[str, Any] = {
            "type": "application" if name == root else "library",
            "bom-ref": f"pkg:cargo/{name}@{version}",
            "name": name,
            "version": version,
            "purl": f"pkg:cargo/{name}@{version}",
        }
        if package["license"]:
            # An older form of "A OR B".
            found["licenses"] = [{"expression": package["license"].replace("/", " OR ")}]
        checksum = checksums.get((name, version))
        if checksum:
            found["hashes"] = [{"alg": "SHA-256", "content": checksum}]
        return found

    everything = [component(package) for package in packages] + vendored()
    top = next(c for c in everything if c["name"] == root)
    others = [c for c in everything if c is not top]
    return {
        "$schema": "http://cyclonedx.org/schema/bom-1.6.schema.json",
        "bomFormat": "CycloneDX",
        "specVersion": "1.6",
        "version": 1,
        "metadata": {"component": top},
        "components": others,
    }


def vendored() -> list[dict[str, Any]]:
    """Components of the bill for the files of others in the page."""
    lines = (VENDOR / "SHA256SUMS").read_text().splitlines()
    sums = dict(reversed(line.split("  ")) for line in lines)
    known = {name for file, *_, licence in VENDORED for name in (file, licence)} | {"notice.js"}
    if unknown := set(sums) - known:
        raise SystemExit(f"vendored files without an entry: {', '.join(sorted(unknown))}")
    found = []
    for file, name, version, licence, source, _ in VENDORED:
        is_data = file.endswith(".bin")
        found.append({
            "type": "data" if is_data else "library",
            "bom-ref": f"vendored:{file}",
            "name": name,
            "version": version,
            "licenses": [{"license": {"name": licence}} if is_data else {"expression": licence}],
            "hashes": [{"alg": "SHA-256", "content": sums[file]}],
            "externalReferences": [{"type": "distribution", "url": source}],
        })
    return found


def lock_checksums() -> dict[tuple[str, str], str]:
    """Checksums of the lock file, by name and version."""
    lock = tomllib.loads(Path("Cargo.lock").read_text())
    return {(p["name"], p["version"]): p["checksum"] for p in lock["package"] if "checksum" in p}


def main(features: str, licence_path: str, bill_path: str) -> None:
    """Write both files."""
    packages = linked(metadata(features), "magline")
    Path(licence_path).write_text(licences(packages))
    Path(bill_path).write_text(json.dumps(bill(packages, "magline", lock_checksums()), indent=1) + "\n")


if __name__ == "__main__":
    main(*sys.argv[1:])

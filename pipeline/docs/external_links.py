#!/usr/bin/env python3
"""Checks the links of all Markdown pages to other sites: external_links.py [--list]

A link is broken if its server reports 404 or 410, or its host does not exist. Other statuses (403 and 429, which
servers send to programs) and timeouts are listed, but are no errors. Without a network, nothing is checked, and the
exit status is 0. `--list` prints the links.
"""

import re
import socket
import subprocess
import sys
import urllib.error
import urllib.request
from concurrent.futures import ThreadPoolExecutor
from urllib.parse import urldefrag, urlsplit

from build import REPOSITORY, outside_code

ADDRESS = re.compile(r"\]\((https?://[^\s()]+(?:\([^\s()]*\)[^\s()]*)*)\)|<(https?://[^\s>]+)>|"
                     r"\]: (https?://\S+)|doi:(10\.[^\s,;\])`|]+)")
# Addresses of examples, which no server has.
EXAMPLES = re.compile(r"localhost$|^127\.|\.example(\.\w+)?$|(^|\.)example\.(org|com|net)$")
# Hosts with a public name that any network reaches.
KNOWN = ["https://doi.org/", "https://github.com/", "https://www.w3.org/"]
TIMEOUT_S = 20
WORKERS = 8


def links() -> dict[str, list[str]]:
    """Returns the pages of each address."""
    listed = subprocess.run(["git", "ls-files", "-co", "--exclude-standard", "*.md"], cwd=REPOSITORY,
                            capture_output=True, text=True, check=True).stdout.splitlines()
    found: dict[str, list[str]] = {}
    for page in (name for name in listed if (REPOSITORY / name).is_file()):
        def part(text: str, page: str = page) -> str:
            for *addresses, doi in ADDRESS.findall(text):
                address = next(filter(None, addresses), "") or f"https://doi.org/{doi.rstrip('.')}"
                if not EXAMPLES.search(urlsplit(address).hostname or ""):
                    found.setdefault(urldefrag(address).url, []).append(page)
            return text

        outside_code((REPOSITORY / page).read_text(encoding="utf-8"), part)
    return found


def status(address: str) -> int | str:
    """Returns the status of an address, or the reason why there is none."""
    for method in ("HEAD", "GET"):
        request = urllib.request.Request(address, method=method, headers={"User-Agent": "Mozilla/5.0 (link check)"})
        try:
            with urllib.request.urlopen(request, timeout=TIMEOUT_S) as answer:
                return answer.status
        except urllib.error.HTTPError as error:
            found: int | str = error.code
        except urllib.error.URLError as error:
            found = "no such host" if isinstance(error.reason, socket.gaierror) else str(error.reason)
        except (OSError, ValueError) as error:
            found = str(error)
    return found


def main() -> int:
    found = links()
    if "--list" in sys.argv:
        print("\n".join(f"{address}  {', '.join(sorted(set(pages)))}" for address, pages in sorted(found.items())))
        return 0
    if not any(isinstance(status(address), int) for address in KNOWN):
        print(f"!!! NOT CHECKED: {len(found)} links to other sites, because no network can be reached", file=sys.stderr)
        return 0
    with ThreadPoolExecutor(WORKERS) as pool:
        answers = dict(zip(found, pool.map(status, found), strict=True))
    broken = {a: s for a, s in answers.items() if s in (404, 410, "no such host")}
    unknown = {a: s for a, s in answers.items() if a not in broken and (isinstance(s, str) or s >= 400)}
    for kind, group in (("broken", broken), ("unknown", unknown)):
        for address, answer in group.items():
            print(f"{kind}: {address}: {answer}; {', '.join(sorted(set(found[address])))}")
    print(f"{len(found)} links to other sites: {len(broken)} broken, {len(unknown)} unknown")
    return 1 if broken else 0


if __name__ == "__main__":
    raise SystemExit(main())

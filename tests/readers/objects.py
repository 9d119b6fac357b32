"""Compares stores, inputs and published sets in an object store with those in folders, byte by byte.

python3 tests/readers/objects.py --magline target/debug/magline [--only NAME]... A magline with the feature
`object-stores`. Needs moto[server], an independent S3 server. A proxy before it rejects, truncates and delays answers.
Exit status 1 if anything differs.
"""

import argparse
import hashlib
import http.client
import json
import os
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

from moto.server import ThreadedMotoServer

ROOT = Path(__file__).resolve().parents[2]
EXAMPLES = ROOT / "datasets/examples"
BUCKET = "lab"
# Objects with times, or of one machine.
TIMED = ("locks/", "tmp/", "costs/", "plans/", "runs/", "index", "STORE", "REMOTE", "attempts/", "checkpoints/")


class Proxy(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    target = None
    fault = staticmethod(lambda method, path, n: None)
    count = 0
    seen = []
    lock = threading.Lock()

    def log_message(self, *_):
        pass

    def handle_one(self):
        with Proxy.lock:
            Proxy.count += 1
            n = Proxy.count
            Proxy.seen.append((self.command, self.path))
        length = int(self.headers.get("Content-Length") or 0)
        body = self.rfile.read(length) if length else None
        fault = Proxy.fault(self.command, self.path, n)
        if fault == "500":
            return self.answer(500, {}, b"<Error><Code>InternalError</Code></Error>")
        if fault == "403":
            text = (b"<Error><Code>AccessDenied</Code><Message>Access Denied</Message>"
                    b"<AWSAccessKeyId>SECRETID</AWSAccessKeyId></Error>")
            return self.answer(403, {}, text)
        if fault == "hang":
            time.sleep(8)
        connection = http.client.HTTPConnection(*Proxy.target, timeout=60)
        headers = {k: v for k, v in self.headers.items() if k.lower() != "connection"}
        connection.request(self.command, self.path, body, headers)
        answer = connection.getresponse()
        data = answer.read()
        own = ("connection", "transfer-encoding", "server", "date")
        headers = {k: v for k, v in answer.getheaders() if k.lower() not in own}
        if self.command == "HEAD":
            self.send_response(answer.status)
            for k, v in headers.items():
                self.send_header(k, v)
            self.end_headers()
            return None
        cut = None
        if fault == "cut" and answer.status in (200, 206) and len(data) > 1:
            cut = len(data) // 2
        # Truncated, with a matching length.
        if fault == "lie" and answer.status == 200 and len(data) > 1:
            data = data[: len(data) // 2]
        return self.answer(answer.status, headers, data, cut)

    def answer(self, *args):
        try:
            self.answered(*args)
        except (BrokenPipeError, ConnectionResetError):
            # The client has disconnected.
            self.close_connection = True

    def answered(self, status, headers, data, cut=None):
        self.send_response(status)
        for k, v in headers.items():
            if k.lower() != "content-length":
                self.send_header(k, v)
        self.send_header("Content-Length", str(len(data)))
        self.end_headers()
        self.wfile.write(data if cut is None else data[:cut])
        if cut is not None:
            self.wfile.flush()
            self.close_connection = True
            self.connection.shutdown(socket.SHUT_RDWR)

    do_GET = do_PUT = do_POST = do_DELETE = do_HEAD = handle_one


class Lab:
    def __init__(self, magline, folder):
        self.magline, self.folder, self.caches = str(Path(magline).resolve()), Path(folder), 0
        self.moto = ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
        self.moto.start()
        Proxy.target = self.moto.get_host_and_port()
        self.proxy = ThreadingHTTPServer(("127.0.0.1", 0), Proxy)
        self.proxy.daemon_threads = True
        threading.Thread(target=self.proxy.serve_forever, daemon=True).start()
        self.endpoint = f"http://127.0.0.1:{self.proxy.server_port}"
        self.request("PUT", f"/{BUCKET}")

    def request(self, method, path, body=None):
        connection = http.client.HTTPConnection(*Proxy.target, timeout=60)
        connection.request(method, path, body, {"Authorization": "AWS4-HMAC-SHA256 "
                                                                 "Credential=x/20260101/us-east-1/s3/aws4_request"})
        answer = connection.getresponse()
        data = answer.read()
        assert answer.status in (200, 204), (method, path, answer.status, data)
        return data

    def objects(self, prefix):
        import xml.etree.ElementTree as tree
        found, token = {}, ""
        while True:
            text = self.request("GET", f"/{BUCKET}?list-type=2&prefix={prefix}/{token}")
            root = tree.fromstring(text)
            space = root.tag.split("}")[0] + "}"
            for one in root.iter(space + "Key"):
                found[one.text[len(prefix) + 1 :]] = self.request("GET", f"/{BUCKET}/{one.text}")
            more = root.find(space + "NextContinuationToken")
            if more is None:
                return found
            token = f"&continuation-token={more.text}"

    def put(self, key, data):
        self.request("PUT", f"/{BUCKET}/{key}", data)

    def cache(self):
        self.caches += 1
        return self.folder / f"cache{self.caches}"

    def env(self, cache, **more):
        env = {k: v for k, v in os.environ.items() if not k.startswith("AWS_")}
        env |= dict(
            MAGLINE_CACHE=str(cache), AWS_ENDPOINT_URL=self.endpoint, AWS_ALLOW_HTTP="true",
            AWS_ACCESS_KEY_ID="geheim-id",
            AWS_SECRET_ACCESS_KEY="geheim-key", AWS_REGION="us-east-1", AWS_TIMEOUT="4 seconds",
        )
        return env | more

    def start(self, args, cache, **more):
        return subprocess.Popen(
            [self.magline, *map(str, args)], env=self.env(cache, **more), cwd=self.folder, text=True,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        )

    def run(self, args, cache, status=0, stdin="", **more):
        process = self.start(args, cache, **more)
        out, err = process.communicate(stdin, timeout=1200)
        assert "geheim" not in out + err and "SECRETID" not in err, "a credential is shown"
        assert process.returncode == status, (args, process.returncode, out[-2000:], err[-3000:])
        return out, err


def rows(text):
    """The rows of an answer, sorted, because without ORDER BY their order is undefined."""
    return sorted(text.splitlines())


def computed(out):
    """Numbers of units by outcome, and the units that were computed more than once."""
    events = [json.loads(line) for line in out.splitlines() if line.startswith("{")]
    units = [e for e in events if e["event"] == "unit"]
    return Counter(e["status"] for e in units)


def files(folder):
    """The files of a store in a folder, by name."""
    found = {}
    for path in sorted(Path(folder).rglob("*")):
        name = path.relative_to(folder).as_posix()
        if path.is_file() and not path.is_symlink() and not name.startswith(TIMED) and not name.startswith("tables/"):
            if not name.endswith((".seen", "version.json")):
                found[name] = path.read_bytes()
    return found


def the_same(expected, found, what):
    names = sorted(set(expected) ^ set(found))
    assert not names, f"{what}: only in one of the two: {names[:10]}"
    differ = [name for name in expected if expected[name] != found[name]]
    assert not differ, f"{what}: other bytes in {differ[:10]}"


def store_of(cache):
    [store] = (cache / "stores").iterdir()
    return store


class Checks:
    def __init__(self, lab, spec):
        self.lab, self.spec, self.number = lab, spec, 0
        self.local = lab.folder / "local"
        out, _ = lab.run(["run", spec, "--set", f"store={self.local}", "--json"], lab.cache())
        self.units = computed(out)
        self.expected = files(self.local)
        print(f"in a folder: {dict(self.units)}, {len(self.expected)} files")

    def prefix(self):
        self.number += 1
        return f"store{self.number}"

    def ran(self, prefix, cache, *more, status=0):
        return self.lab.run(["run", self.spec, "--set", f"store=s3://{BUCKET}/{prefix}", "--json", *more], cache,
                            status)

    def bucket_is_right(self, prefix):
        found = {name: data for name, data in self.lab.objects(prefix).items() if not name.startswith(TIMED)}
        expected = {n: d for n, d in self.expected.items() if not n.startswith("versions/")}
        plain = {n: d for n, d in found.items() if not n.startswith(("versions/", "tables/"))}
        the_same(expected, plain, "the bucket")
        own = {n: d for n, d in found.items() if n.startswith("versions/") and not n.endswith("version.json")}
        for name, data in own.items():
            assert self.expected[name] == data, f"other bytes in {name}"

    def same_bytes(self):
        prefix, cache = self.prefix(), self.lab.cache()
        Proxy.seen.clear()
        out, _ = self.ran(prefix, cache)
        assert computed(out) == self.units, computed(out)
        the_same(self.expected, files(store_of(cache)), "the cache")
        self.bucket_is_right(prefix)
        puts = Counter(path.split("?")[0] for method, path in Proxy.seen if method == "PUT" and "/objects/" in path)
        assert max(puts.values()) == 1, "a pack was written twice"
        print(f"  {len(Proxy.seen)} requests, {sum(puts.values())} packs")
        again, _ = self.ran(prefix, cache)
        assert computed(again)["computed"] == 0
        cold = self.lab.cache()
        again, _ = self.ran(prefix, cold)
        assert computed(again)["computed"] == 0
        copied = [n for n in files(store_of(cold)) if n.startswith("objects/")]
        print(f"  with an empty cache {len(copied)} of {sum(n.startswith('objects/') for n in self.expected)} packs "
              "are copied")
        ls, _ = self.lab.run(["ls", "--store", f"s3://{BUCKET}/{prefix}"], self.lab.cache())
        for line in ls.splitlines()[1:]:
            table = line.split()[0]
            query = f"SELECT * FROM {table}"
            here = self.lab.run(["sql", query, "--store", self.local, "--format", "json"], cold)[0]
            there = self.lab.run(["sql", query, "--store", f"s3://{BUCKET}/{prefix}", "--format", "json"],
                                 self.lab.cache())[0]
            assert rows(here) == rows(there) and (here or line.split()[1] == "0"), table
        self.lab.run(["verify", "--store", f"s3://{BUCKET}/{prefix}"], self.lab.cache())

    def workers(self):
        prefix = self.prefix()
        address, cache = f"s3://{BUCKET}/{prefix}", self.lab.cache()
        receipts = []
        while True:
            tasks, _ = self.lab.run(["tasks", self.spec, "--set", f"store={address}", "--units", 4], cache)
            if not tasks:
                break
            lines = tasks.splitlines()
            workers = [self.lab.start(["task", "--store", address, "--threads", 1], self.lab.cache()) for _ in range(2)]
            for i, worker in enumerate(workers):
                out, err = worker.communicate("\n".join(lines[i::2]) + "\n", timeout=1200)
                assert worker.returncode == 0, err
                receipts += [json.loads(line) for line in out.splitlines()]
        made = Counter(u["key"] for r in receipts for u in r["units"] if u["outcome"] == "computed")
        assert max(made.values()) == 1, "a unit was computed twice"
        self.ran(prefix, cache)
        copy = files(store_of(cache))
        for name, data in self.expected.items():
            assert name.startswith(("objects/", "versions/")) or copy[name] == data, name
        query = ["sql", "SELECT * FROM " + self.scores(address), "--format", "json", "--store"]
        found = self.lab.run([*query, address], self.lab.cache())[0]
        assert rows(found) == rows(self.lab.run([*query, self.local], cache)[0])
        out, _ = self.ran(self.prefix(), self.lab.cache(), "--engine", "processes")
        assert computed(out) == self.units

    def scores(self, address):
        ls, _ = self.lab.run(["ls", "--store", address], self.lab.cache())
        return next(line.split()[0] for line in ls.splitlines()[1:] if int(line.split()[1]) > 0)

    def killed(self):
        prefix, cache, killed = self.prefix(), self.lab.cache(), 0
        while True:
            process = self.lab.start(["run", self.spec, "--set", f"store=s3://{BUCKET}/{prefix}", "--quiet"], cache)
            try:
                process.wait(0.7 + 0.4 * killed)
                assert process.returncode == 0, process.stderr.read()
                break
            except subprocess.TimeoutExpired:
                process.send_signal(signal.SIGKILL)
                process.wait()
                killed += 1
        assert killed > 0
        the_same(self.expected, files(store_of(cache)) | {}, "the cache")
        self.bucket_is_right(prefix)
        print(f"  killed {killed} times")

    def two_at_once(self):
        prefix = self.prefix()
        args = ["run", self.spec, "--set", f"store=s3://{BUCKET}/{prefix}", "--json", "--wait"]
        both = [self.lab.start(args, self.lab.cache()) for _ in range(2)]
        outs = [p.communicate(timeout=1200) for p in both]
        assert all(p.returncode == 0 for p in both), outs
        total = sum((computed(out) for out, _ in outs), Counter())
        assert total["computed"] == self.units["computed"], total
        self.bucket_is_right(prefix)

    def faulty(self):
        kinds = {
            "every fifth request is refused": lambda method, path, n: "500" if n % 5 == 0 else None,
            "every fourth answer is cut": lambda method, path, n: "cut" if method == "GET" and n % 4 == 0 else None,
            "every seventh answer is cut and says so": lambda method, path, n: (
                "lie" if method == "GET" and "/objects/" in path and n % 7 == 0 else None
            ),
            "some answers are late": lambda method, path, n: "hang" if n % 40 == 0 else None,
        }
        for what, fault in kinds.items():
            prefix, cache = self.prefix(), self.lab.cache()
            Proxy.fault = staticmethod(fault)
            begun = time.time()
            self.ran(prefix, cache)
            self.ran(prefix, self.lab.cache())
            query = ["sql", "SELECT * FROM " + self.scores(f"s3://{BUCKET}/{prefix}"), "--format", "json", "--store"]
            there, _ = self.lab.run([*query, f"s3://{BUCKET}/{prefix}"], self.lab.cache())
            Proxy.fault = staticmethod(lambda method, path, n: None)
            assert rows(there) == rows(self.lab.run([*query, self.local], cache)[0])
            the_same(self.expected, files(store_of(cache)), what)
            self.bucket_is_right(prefix)
            print(f"  {what}: the same, {time.time() - begun:.1f} s")

    def refused(self):
        def fault(args, status=1, **more):
            begun = time.time()
            _, err = self.lab.run(args, self.lab.cache(), status, **more)
            print(f"  {time.time() - begun:5.1f} s  {err.strip().splitlines()[0][:150]}")
            return err

        run = ["run", self.spec, "--quiet", "--set"]
        assert "there is no bucket s3://nowhere" in fault([*run, "store=s3://nowhere/x"])
        Proxy.fault = staticmethod(lambda method, path, n: "403")
        assert "do not permit" in fault([*run, f"store=s3://{BUCKET}/x"])
        Proxy.fault = staticmethod(lambda method, path, n: "500")
        assert "500" in fault([*run, f"store=s3://{BUCKET}/x"])
        Proxy.fault = staticmethod(lambda method, path, n: None)
        fault([*run, f"store=s3://{BUCKET}/x"], AWS_ENDPOINT_URL="http://127.0.0.1:9")
        assert "AWS_ALLOW_HTTP" in fault([*run, f"store=s3://{BUCKET}/x"], AWS_ALLOW_HTTP="false")
        assert "no profile `lab`" in fault([*run, f"store=s3://{BUCKET}/x"], AWS_PROFILE="lab")
        fault([*run, "store=gs://bucket/x"], GOOGLE_APPLICATION_CREDENTIALS="/nowhere.json")
        fault([*run, "store=az://container/x"])
        fault([*run, "store=s3://id:geheim@bucket/x"], 2)
        fault(["ls", "--store", f"s3://{BUCKET}/nothing"], 2)

    def inputs(self):
        flights = self.lab.folder / "flights.csv"
        lines = ["tt,flight,line,mag_1_uc"] + [f"{t / 10},1,1.01,{50000 + (t * t) % 97}" for t in range(600)]
        flights.write_text("\n".join(lines) + "\n")
        self.lab.put("in/a.csv", flights.read_bytes())
        spec = self.lab.folder / "inputs.toml"
        spec.write_text(
            f'name = "inputs"\nstore = "s3://{BUCKET}/of_inputs"\n[tables.flights]\npath = "s3://{BUCKET}/in/*.csv"\n'
            '[[stages]]\nname = "even"\nstage = "resample"\ninput = "flights"\nrate_hz = 10.0\n'
        )
        cache = self.lab.cache()
        out, _ = self.lab.run(["run", spec, "--json"], cache)
        assert computed(out)["computed"] == 1, out
        assert computed(self.lab.run(["run", spec, "--json"], cache)[0])["reused"] == 1
        # The same bytes, written again: nothing is computed.
        self.lab.put("in/a.csv", flights.read_bytes())
        assert computed(self.lab.run(["run", spec, "--json"], cache)[0])["computed"] == 0
        # One added flight, then one changed flight.
        self.lab.put("in/b.csv", flights.read_text().replace(",1,1.01,", ",2,2.01,").encode())
        assert computed(self.lab.run(["run", spec, "--json"], cache)[0])["computed"] == 1
        self.lab.put("in/a.csv", flights.read_text().replace("50000", "50001").encode())
        out, _ = self.lab.run(["run", spec, "--json"], cache)
        assert (computed(out)["computed"], computed(out)["reused"]) == (1, 1), out
        # The same run on files.
        local = self.lab.folder / "in"
        local.mkdir()
        for name, data in self.lab.objects("in").items():
            (local / name).write_bytes(data)
        other = self.lab.folder / "files.toml"
        text = spec.read_text().replace(f"s3://{BUCKET}/in/", f"{local}/")
        other.write_text(text.replace(f"s3://{BUCKET}/of_inputs", str(self.lab.folder / "of_files")))
        self.lab.run(["run", other], cache)
        query = ["sql", "SELECT * FROM inputs.even", "--format", "json", "--store"]
        there = self.lab.run([*query, f"s3://{BUCKET}/of_inputs"], cache)[0]
        assert rows(there) == rows(self.lab.run([*query, self.lab.folder / "of_files"], cache)[0])
        keys = lambda objects: {n for n in objects if n.startswith("objects/")}
        of_files, of_inputs = keys(files(self.lab.folder / "of_files")), keys(self.lab.objects("of_inputs"))
        assert of_files <= of_inputs, "keys depend on where files are"
        lineage, _ = self.lab.run(["lineage", "inputs.even", "--store", f"s3://{BUCKET}/of_inputs"], cache)
        assert f"s3://{BUCKET}/in/a.csv" in lineage and str(cache) not in lineage, lineage

    def published(self):
        prefix, cache = self.prefix(), self.lab.cache()
        spec = self.lab.folder / "published.toml"
        text = Path(self.spec).read_text().replace('path   = "', 'path = "').replace('path = "', f'path = "{EXAMPLES}/')
        about = ('[publish]\ntitle = "a"\ndescription = "b"\nlicence = "CC-BY-4.0"\ncontact = "a@b.org"\n'
                 'date = "2026-01-01"\nauthors = [{ name = "A B" }]\n')
        spec.write_text(text + "\n" + about)
        address = f"s3://{BUCKET}/{prefix}"
        self.lab.run(["run", spec, "--set", f"store={address}"], cache)
        ls, _ = self.lab.run(["ls", "--store", address], cache)
        tables = [line.split()[0].split(".")[1] for line in ls.splitlines()[1:]]
        tables = [t for t in tables if t not in ("failures", "warnings", "quality")][:2]
        folder = self.lab.folder / "set"
        more = ["--set", f"store={address}", "--to"]
        self.lab.run(["publish", spec, *tables, *more, folder], cache)
        self.lab.run(["publish", spec, *tables, *more, f"s3://{BUCKET}/published/set"], cache)
        here = {p.relative_to(folder).as_posix(): p.read_bytes() for p in folder.rglob("*") if p.is_file()}
        the_same(here, self.lab.objects("published/set"), "the set")
        out, _ = self.lab.run(["publish", spec, *tables, *more, f"s3://{BUCKET}/published/set"], cache)
        assert "already holds the same published set" in out
        sums = self.lab.objects("published/set")["SHA256SUMS"].decode().splitlines()
        for line in sums:
            sum_, name = line.split(maxsplit=1)
            assert hashlib.sha256(here[name.strip().lstrip("*")]).hexdigest() == sum_
        html, _ = self.lab.run(["report", spec, "--set", f"store={address}", "-o", self.lab.folder / "a.html"],
                               self.lab.cache())


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--magline", default="target/debug/magline")
    parser.add_argument("--spec", default=str(EXAMPLES / "tolles_lawson.toml"))
    parser.add_argument("--only", action="append")
    args = parser.parse_args()
    names = ["same_bytes", "workers", "killed", "two_at_once", "faulty", "refused", "inputs", "published"]
    wrong = 0
    with tempfile.TemporaryDirectory() as folder:
        checks = Checks(Lab(args.magline, folder), str(Path(args.spec).resolve()))
        for name in args.only or names:
            begun = time.time()
            try:
                getattr(checks, name)()
                print(f"{name}: fine, {time.time() - begun:.1f} s", flush=True)
            except (AssertionError, subprocess.TimeoutExpired) as e:
                wrong += 1
                print(f"{name}: WRONG: {e}", flush=True)
            Proxy.fault = staticmethod(lambda method, path, n: None)
    sys.exit(1 if wrong else 0)


if __name__ == "__main__":
    main()

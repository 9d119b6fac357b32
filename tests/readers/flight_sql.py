"""Queries a served store with the ADBC client of Flight SQL, and compares rows and sums of every numeric column with
those that pyarrow reads from the published files. See README.md beside this file."""

import argparse
import re
import secrets
import signal
import subprocess
import sys
import tempfile
import threading
from pathlib import Path

import adbc_driver_flightsql.dbapi as flight_sql
import adbc_driver_manager
import pandas
import polars
import pyarrow as pa
from adbc_driver_flightsql import DatabaseOptions

from readers import differences, kinds, tables, with_pyarrow


class Server:
    """`magline serve` on a free port of this machine."""

    def __init__(self, magline, store, *more):
        self.process = subprocess.Popen([magline, "serve", "--store", store, "--bind", "127.0.0.1:0", *more],
                                        stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
        self.line = self.process.stderr.readline()
        found = re.search(r"(grpc(\+tls)?://\S+),", self.line)
        if not found:
            self.process.kill()
            sys.exit(f"no address in {self.line!r}")
        self.uri = found.group(1)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.process.send_signal(signal.SIGTERM)
        assert self.process.wait(30) == 0, "it does not end cleanly"


def quoted(name):
    return ".".join(f'"{part}"' for part in name.split("."))


def with_adbc(connection, name, columns):
    """Rows, and for each column the number of values, their sum, and the sum of their absolute values."""
    import pyarrow.compute as pc

    found = {}
    with connection.cursor() as cursor:
        for column, kind in columns.items():
            cursor.execute(f'SELECT "{column}" FROM {quoted(name)}')
            # Batches are processed as they arrive.
            n, total, size = 0, 0.0, 0.0
            for batch in cursor.fetch_record_batch():
                values = batch.column(0)
                values = (pc.list_flatten(values) if kind == "list" else values).cast(pa.float64())
                values = pc.filter(values, pc.invert(pc.is_nan(values)), null_selection_behavior="drop")
                n += len(values)
                total += pc.sum(values).as_py() or 0.0
                size += pc.sum(pc.abs(values)).as_py() or 0.0
            found[column] = (n, total, size)
        cursor.execute(f"SELECT count(*) FROM {quoted(name)}")
        return cursor.fetchone()[0], found


def fails(what, words, work):
    """Whether `work` fails with a message that contains these words."""
    try:
        work()
    except adbc_driver_manager.Error as e:
        assert words in str(e), f"{what}: {e}"
        return
    raise AssertionError(f"{what} is not refused")


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("store")
    parser.add_argument("--magline", default="target/debug/magline")
    options = parser.parse_args()
    wrong = 0
    with tempfile.TemporaryDirectory() as folder:
        token, file = secrets.token_hex(32), Path(folder) / "token"
        file.touch(0o600)
        file.write_text(token + "\n")
        with Server(options.magline, options.store, "--token-file", str(file), "--timeout", "60") as server:
            bearer = {DatabaseOptions.AUTHORIZATION_HEADER.value: f"Bearer {token}"}
            everything = tables(options.store)
            with flight_sql.connect(server.uri, db_kwargs=bearer, autocommit=True) as connection:
                for name, path in everything.items():
                    columns = kinds(path)
                    ours = with_adbc(connection, name, columns)
                    said = list(differences(ours, with_pyarrow(path, columns)))
                    wrong += bool(said)
                    print(f"{name}: {ours[0]} rows, {len(columns)} columns: {', '.join(said) or 'the same'}")
                info = connection.adbc_get_info()
                assert info["vendor_name"] == "magline", info
                objects = connection.adbc_get_objects(depth="columns").read_all().to_pylist()
                known = {f"{s['db_schema_name']}.{t['table_name']}": [c["column_name"] for c in t["table_columns"]]
                         for catalog in objects for s in catalog["catalog_db_schemas"] for t in s["db_schema_tables"]}
                assert set(everything) <= set(known), set(everything) - set(known)
                some = next(n for n in everything if "line" in known[n] and "tt" in known[n])
                schema = connection.adbc_get_table_schema(some.split(".")[1], db_schema_filter=some.split(".")[0])
                assert schema.names == known[some], (schema.names, known[some])
                assert connection.adbc_get_table_types() == ["TABLE"]
                with connection.cursor() as cursor:
                    cursor.execute(f"SELECT line, count(*) FROM {quoted(some)} GROUP BY line ORDER BY line")
                    for line, rows in cursor.fetchall():
                        cursor.execute(f"SELECT count(*) FROM {quoted(some)} WHERE line = $1 AND tt > $2", (line, -1.0))
                        assert cursor.fetchone()[0] == rows, line
                        cursor.execute(f"SELECT count(*) FROM {quoted(some)} WHERE line = ? AND tt > ?", (line, -1))
                        assert cursor.fetchone()[0] == rows, line
                    query = f"SELECT line, count(*) AS n FROM {quoted(some)} GROUP BY line ORDER BY line"
                    cursor.execute(query)
                    counted = cursor.fetch_arrow_table()
                    assert pandas.read_sql(query, connection)["n"].tolist() == counted["n"].to_pylist()
                    assert polars.read_database(query, connection)["n"].to_list() == counted["n"].to_pylist()
                    for query in [f"DROP TABLE {quoted(some)}", f"DELETE FROM {quoted(some)}",
                                  f"INSERT INTO {quoted(some)} SELECT * FROM {quoted(some)}",
                                  "COPY (SELECT 1) TO '/tmp/x'"]:
                        fails(query, "rejected", lambda query=query: cursor.execute(query))
                    fails("ingest", "", lambda: cursor.adbc_ingest("new", pa.table({"a": [1]})))
                    fails("no table", "there is no table", lambda: cursor.execute("SELECT * FROM nowhere.nothing"))

            def counts():
                with flight_sql.connect(server.uri, db_kwargs={"username": "any", "password": token},
                                        autocommit=True) as one:
                    with one.cursor() as cursor:
                        cursor.execute(f"SELECT count(*) FROM {quoted(some)}")
                        answers.append(cursor.fetchone()[0])

            answers = []
            threads = [threading.Thread(target=counts) for _ in range(50)]
            [t.start() for t in threads], [t.join() for t in threads]
            assert len(answers) == 50 and len(set(answers)) == 1, answers

            # A client that disconnects during a long answer does not block others.
            with flight_sql.connect(server.uri, db_kwargs=bearer, autocommit=True) as one, one.cursor() as cursor:
                cursor.execute(f"SELECT a.tt, b.tt AS u FROM {quoted(some)} a, {quoted(some)} b")
                assert cursor.fetch_record_batch().read_next_batch().num_rows > 0
            counts()
            taken = subprocess.run([options.magline, "serve", "--store", options.store, "--bind",
                                    server.uri.split("//")[1]],
                                   capture_output=True, text=True)
            assert taken.returncode != 0 and "cannot listen" in taken.stderr, taken

            def ask(**headers):
                with flight_sql.connect(server.uri, db_kwargs=headers, autocommit=True) as one, one.cursor() as cursor:
                    cursor.execute("SELECT 1")

            fails("no token", "token is missing or wrong", ask)
            fails("another token", "token is missing or wrong",
                  lambda: ask(**{DatabaseOptions.AUTHORIZATION_HEADER.value: "Bearer " + token[::-1]}))
            fails("another password", "token is missing or wrong", lambda: ask(username="any", password=token[::-1]))
        pem = Path(__file__).resolve().parents[1] / "reference/serve"
        encrypted = ["--tls-cert", str(pem / "localhost.pem"), "--tls-key", str(pem / "localhost.key")]
        with Server(options.magline, options.store, "--token-file", str(file), *encrypted) as server:
            trust = {DatabaseOptions.TLS_ROOT_CERTS.value: (pem / "ca.pem").read_text()}
            with flight_sql.connect(server.uri, db_kwargs=bearer | trust,
                                    autocommit=True) as one, one.cursor() as cursor:
                cursor.execute(f"SELECT count(*) FROM {quoted(some)}")
                assert cursor.fetchone()[0] == answers[0]
            fails("an unknown authority", "", lambda: ask(**bearer))
    print("token, parameters, refusals, 50 clients at once, encryption: as they should be")
    sys.exit(1 if wrong else 0)


if __name__ == "__main__":
    main()

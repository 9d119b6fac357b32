"""As readers.py, with PySpark's default vectorised reader in local mode. Exits 77 where PySpark or Java is missing."""

import os
import shutil
import sys

from readers import arguments, compare


def session():
    try:
        from pyspark.sql import SparkSession
    except ImportError:
        print("skipped: there is no pyspark; pip install pyspark")
        sys.exit(77)
    home = os.environ.get("JAVA_HOME")
    if not (shutil.which("java") or home and os.access(os.path.join(home, "bin", "java"), os.X_OK)):
        print("skipped: there is no Java; apt-get install default-jre-headless")
        sys.exit(77)
    spark = (SparkSession.builder.master("local[2]").config("spark.ui.enabled", "false")
             .config("spark.ui.showConsoleProgress", "false").config("spark.sql.shuffle.partitions", "2").getOrCreate())
    spark.sparkContext.setLogLevel("ERROR")
    return spark


def main():
    store, binary = arguments(__doc__)
    spark = session()
    from pyspark.sql import functions as f

    if spark.conf.get("spark.sql.parquet.enableVectorizedReader") != "true":
        sys.exit("the vectorised reader is off")

    def with_spark(folder, columns):
        data = spark.read.parquet(str(folder.resolve()))
        rows = data.count()
        found = {}
        for name, kind in columns.items():
            x = f.col("`" + name.replace("`", "``") + "`")
            x = (f.explode(x) if kind == "list" else x).alias("x")
            x = data.select(x).select(f.col("x").cast("double").alias("x")).where("NOT isnan(x) AND x IS NOT NULL")
            n, s, a = x.agg(f.count("x"), f.sum("x"), f.sum(f.abs("x"))).first()
            found[name] = (n, s or 0.0, a or 0.0)
        return rows, found

    wrong = compare(store, binary, {"spark": with_spark})
    spark.stop()
    sys.exit(1 if wrong else 0)


if __name__ == "__main__":
    main()

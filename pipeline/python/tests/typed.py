"""Calls that type checkers reject. mypy and pyright report a comment that is not needed."""

import magline

spec = magline.Spec("typed")
flights = spec.table("flights", "flights.parquet")
even = spec.resample(input=flights, rate_hz=spec.axis("rate", [5.0, 10.0]), method="cubic")
spec.fit(input=even, model="tolles_lawson", target="mag_1_uc", lambda_=0.025, hidden=[8], features=["tl"])

spec.fit(input=even, model="toles_lawson", target="mag_1_uc")  # type: ignore[arg-type]
spec.fit(input=even, model="ridge", target="mag_1_uc", lamda=0.025)  # type: ignore[call-arg]
spec.fit(input=even, model="ridge")  # type: ignore[call-arg]
spec.resample(input=flights, rate_hz="10")  # type: ignore[arg-type]
spec.navigate(input=even, map="anomaly", measurement_sigma_nt="atuo")  # type: ignore[arg-type]
spec.score(input=even, metrics=["std_eror"])  # type: ignore[list-item]
spec.table("map")  # type: ignore[call-arg]

"""Calls that type checkers reject. mypy and pyright report a comment that is not needed."""

import magline
import numpy as np

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

t = np.arange(10.0)
field = magline.maps.open("map.tif")
track = magline.filters.ekf(t, t, t, t, t, field, gate_nis=9.0, start="given", fix=["lat", "lon", "alt"])
spread: float = track.covariance_m2[0, 0, 0] + track.sd_n_m[0]
magline.filters.navigate("own", t, t, t, t, {"mag_1_c": t}, None, own_key=3)

magline.filters.ekf(t, t, t, t, t, field, gate_nis="9")  # type: ignore[arg-type]
magline.filters.ekf(t, t, t, t, t, field, particles=10)  # type: ignore[call-arg]
magline.filters.mpf(t, t, t, t, t)  # type: ignore[call-arg]
magline.filters.ukf(t, t, t, t, t, field, start="fixed")  # type: ignore[arg-type]

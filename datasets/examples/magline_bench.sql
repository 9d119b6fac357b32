-- The predictions of magline_bench.toml: one row per sample, one column per scored quantity.
WITH compensated AS (
  SELECT flight, line, tt,
    max(CASE mag WHEN 'mag_1_uc' THEN mag_c END) AS mag_1_comp, max(CASE mag WHEN 'mag_2_uc' THEN mag_c END) AS mag_2_comp,
    max(CASE mag WHEN 'mag_3_uc' THEN mag_c END) AS mag_3_comp, max(CASE mag WHEN 'mag_4_uc' THEN mag_c END) AS mag_4_comp,
    max(CASE mag WHEN 'mag_5_uc' THEN mag_c END) AS mag_5_comp
  FROM magline_bench.clean GROUP BY flight, line, tt)
SELECT c.*, track.lat, track.lon, cold.lat AS cold_lat, cold.lon AS cold_lon, free.lat AS free_lat, free.lon AS free_lon
FROM compensated AS c
  JOIN magline_bench.track ON track.line = c.line AND track.tt = c.tt
  JOIN magline_bench.cold ON cold.line = c.line AND cold.tt = c.tt
  JOIN magline_bench.free ON free.line = c.line AND free.tt = c.tt
ORDER BY c.line, c.tt

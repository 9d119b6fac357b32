-- Survey lines as flights: the time of each point is its distance along the line divided by 65 m/s.
--
-- A metre is 1/110745 degree of latitude at 21.9 degrees south and 1/103306 degree of longitude (WGS-84). Over the area, the
-- error of this, and of the ground speed, is at most 0.3 %.

-- The sortie: its legs in order, each in (1) or against (-1) the order of the file, and the width of the following turn (m),
-- chosen for a radius above 500 m.
WITH legs (leg, line, way, wide_m) AS (
    VALUES (1, '10066', 1, 20000), (2, '10149', -1, 14000), (3, '10130', -1, 20000), (4, '10155', 1, 14000),
           (5, '10078', 1, 20000), (6, '10151', -1, 20000), (7, '10118', 1, 20000), (8, '10153', 1, 20000),
           (9, '10088', -1, 7000), (10, '10108', -1, 5000), (11, '10098', 1, 7000), (12, '10083', -1, 0)
),
-- The tie lines read more than the lines that they cross: medians of 17 to 29 nT for each of 18 tie lines, 650 crossings.
levelled AS (
    SELECT line, tt, lat, lon, alt,
           anomaly - CASE WHEN line LIKE '58%' THEN 29 WHEN line BETWEEN '10149' AND '10166' THEN 24 ELSE 0 END AS anomaly
    FROM osborne_points.lines
),
measured AS (
    SELECT leg, wide_m, way * tt AS k, lat, lon, alt, anomaly
    FROM levelled JOIN legs USING (line)
    -- The tie lines continue northward for another 15 km; the sortie stays over the block whose lines it flies.
    WHERE lat BETWEEN -22.0 AND -21.8775
),
-- Start and end of a leg, and its direction over about 350 m, in metres.
numbered AS (
    SELECT *, row_number() OVER (PARTITION BY leg ORDER BY k) AS i, count(*) OVER (PARTITION BY leg) AS n,
           103306 * (lon - 140.74) AS e_m, 110745 * (lat + 21.94) AS n_m
    FROM measured
),
ends AS (
    SELECT leg, max(wide_m) AS m,
           max(CASE WHEN i = 1 THEN e_m END) AS e0, max(CASE WHEN i = 1 THEN n_m END) AS n0,
           max(CASE WHEN i = 50 THEN e_m END) AS e0b, max(CASE WHEN i = 50 THEN n_m END) AS n0b,
           max(CASE WHEN i = n THEN e_m END) AS e1, max(CASE WHEN i = n THEN n_m END) AS n1,
           max(CASE WHEN i = n - 49 THEN e_m END) AS e1b, max(CASE WHEN i = n - 49 THEN n_m END) AS n1b,
           max(CASE WHEN i = 1 THEN alt END) AS alt0, max(CASE WHEN i = n THEN alt END) AS alt1
    FROM numbered GROUP BY leg
),
-- From the end of a leg to the start of the next: a cubic with the directions of both. It is not part of the survey and has
-- no measurement.
turns AS (
    SELECT a.leg, a.e1, a.n1, a.alt1, b.e0, b.n0, b.alt0,
           (a.e1 - a.e1b) / sqrt(power(a.e1 - a.e1b, 2) + power(a.n1 - a.n1b, 2)) AS ue,
           (a.n1 - a.n1b) / sqrt(power(a.e1 - a.e1b, 2) + power(a.n1 - a.n1b, 2)) AS un,
           (b.e0b - b.e0) / sqrt(power(b.e0b - b.e0, 2) + power(b.n0b - b.n0, 2)) AS ve,
           (b.n0b - b.n0) / sqrt(power(b.e0b - b.e0, 2) + power(b.n0b - b.n0, 2)) AS vn,
           a.m
    FROM ends a JOIN ends b ON b.leg = a.leg + 1
),
turned AS (
    SELECT leg, u,
           (1 + 2 * u) * power(1 - u, 2) * e1 + u * power(1 - u, 2) * m * ue
           + u * u * (3 - 2 * u) * e0 + u * u * (u - 1) * m * ve AS e_m,
           (1 + 2 * u) * power(1 - u, 2) * n1 + u * power(1 - u, 2) * m * un
           + u * u * (3 - 2 * u) * n0 + u * u * (u - 1) * m * vn AS n_m,
           alt1 + u * (alt0 - alt1) AS alt
    FROM turns CROSS JOIN (SELECT value / 500.0 AS u FROM generate_series(1, 499))
),
path AS (
    SELECT 'line' AS flight, line, 0 AS leg, tt AS k, lat, lon, alt, anomaly FROM levelled
    UNION ALL
    SELECT 'sortie', 'sortie', leg, i, lat, lon, alt, anomaly FROM numbered
    UNION ALL
    SELECT 'sortie', 'sortie', leg, 1e6 + u, n_m / 110745 - 21.94, e_m / 103306 + 140.74, alt, NULL FROM turned
),
steps AS (
    SELECT *, coalesce(sqrt(power(110745 * (lat - lag(lat) OVER w), 2) + power(103306 * (lon - lag(lon) OVER w), 2)), 0) AS step_m
    FROM path WINDOW w AS (PARTITION BY flight, line ORDER BY leg, k)
)
SELECT flight, line, sum(step_m) OVER (PARTITION BY flight, line ORDER BY leg, k) / 65.0 AS tt, lat, lon, alt, anomaly
FROM steps
ORDER BY flight, line, tt

-- DRMS in m of each line and method after the first ten minutes, as in the published tables, and over the whole line.
-- `after_300_s` is for the method with five minutes of GNSS. The INS alone is shifted to the true position at the first sample.
with start as (
    select flight, line, min(tt) as tt, first_value(lat - ins_lat order by tt) as lat, first_value(lon - ins_lon order by tt) as lon
    from sgl_lines.even group by flight, line
), tracks as (
    select '1 INS alone' as method, '-' as mag, e.flight, e.line, e.tt, e.ins_lat + s.lat as lat, e.ins_lon + s.lon as lon
    from sgl_lines.even e join start s using (flight, line)
    union all select '2 EKF', 'stinger', flight, line, tt, lat, lon from sgl_lines.filter_eastern
    union all select '2 EKF', 'stinger', flight, line, tt, lat, lon from sgl_lines.filter_renfrew
    union all select case when loss = 'none' then '3 batch' else '4 batch, Huber' end, 'stinger', flight, line, tt, lat, lon from sgl_lines.batch_eastern
    union all select case when loss = 'none' then '3 batch' else '4 batch, Huber' end, 'stinger', flight, line, tt, lat, lon from sgl_lines.batch_renfrew
    union all select case when gnss like '0%' then '5 cold start' else '6 five minutes of GNSS' end || case when terms like '%cur_%' then ', currents' else '' end,
                     mag, flight, line, tt, lat, lon from sgl_lines.lagged_eastern
    union all select case when gnss like '0%' then '5 cold start' else '6 five minutes of GNSS' end || case when terms like '%cur_%' then ', currents' else '' end,
                     mag, flight, line, tt, lat, lon from sgl_lines.lagged_renfrew
), errors as (
    select t.method, t.mag, t.line, t.tt - s.tt as seconds,
           power(radians(t.lat - e.lat) * 6335439.0 / power(1 - 0.00669438 * power(sin(radians(e.lat)), 2), 1.5), 2)
         + power(radians(t.lon - e.lon) * cos(radians(e.lat)) * 6378137.0 / sqrt(1 - 0.00669438 * power(sin(radians(e.lat)), 2)), 2) as square
    from tracks t join sgl_lines.even e using (flight, line, tt) join start s using (flight, line)
)
select line, method, mag, round(sqrt(avg(square)), 1) as whole,
       round(sqrt(avg(case when seconds >= 300 then square end)), 1) as after_300_s,
       round(sqrt(avg(case when seconds >= 600 then square end)), 1) as after_600_s
from errors group by line, method, mag order by line, method, mag

-- Standard deviation in nT, pooled over the lines, of what linear models leave with ideal and with real sensors.
select mag, replace(replace(vectors, 'TL_A_flux_', ''), '+', ',') as vectors,
       round(tl_ideal, 1) as tl_ideal, round(tl_real, 1) as tl_real,
       round(pi.value, 1) as pls_ideal, round(pr.value, 1) as pls_real,
       round(ni.value, 1) as net_ideal, round(nr.value, 1) as net_real
from real_sensors.ideal_pls pi
join real_sensors.real_pls pr using (mag, vectors, metric)
join real_sensors.ideal_net ni using (mag, vectors, metric)
join real_sensors.real_net nr using (mag, vectors, metric)
join (select mag, metric, min(value) as tl_ideal from real_sensors.ideal_box group by mag, metric) using (mag, metric)
join (select mag, metric, min(value) as tl_real from real_sensors.real_box group by mag, metric) using (mag, metric)
where metric = 'std_error'
order by mag, length(vectors), vectors

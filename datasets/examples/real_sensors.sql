-- Standard deviation of the residual in nT, pooled over the lines, of linear models with ideal and with realistic sensors.
with box as (
    select i.mag as tl_mag, round(min(i.value), 1) as tl_ideal, round(min(r.value), 1) as tl_real
    from real_sensors.ideal_box i join real_sensors.real_box r on i.mag = r.mag and i.vector = r.vector and i.metric = r.metric
    where i.metric = 'std_error' group by i.mag
)
select pi.mag, replace(replace(pi.vectors, 'TL_A_flux_', ''), '+', ',') as flux, tl_ideal, tl_real,
       round(pi.value, 1) as pls_ideal, round(pr.value, 1) as pls_real,
       round(ni.value, 1) as net_ideal, round(nr.value, 1) as net_real
from real_sensors.ideal_pls pi
join real_sensors.real_pls pr on pi.mag = pr.mag and pi.vectors = pr.vectors and pi.metric = pr.metric
join real_sensors.ideal_net ni on pi.mag = ni.mag and pi.vectors = ni.vectors and pi.metric = ni.metric
join real_sensors.real_net nr on pi.mag = nr.mag and pi.vectors = nr.vectors and pi.metric = nr.metric
join box on tl_mag = pi.mag
where pi.metric = 'std_error'
order by pi.mag, length(pi.vectors), pi.vectors

-- Standard deviation in nT, pooled over the test lines: one magnetometer with one or two vector magnetometers.
with box as (select mag, min(value) as value from thesis_000_networks.box where metric = 'std_error' group by mag),
linear as (
    select mag, vectors, max(case when linear = 'pls' then value end) as pls, max(case when linear = 'ridge' then value end) as ridge
    from thesis_000_networks.linear where metric = 'std_error' group by mag, vectors
),
network as (
    select mag, vectors, max(case when model = 'm1' then value end) as m1, max(case when model = 'm2c' then value end) as m2c,
           max(case when model = 'etlnn' then value end) as etlnn
    from thesis_000_networks.network where metric = 'std_error' group by mag, vectors
)
select linear.mag, replace(replace(linear.vectors, 'TL_A_flux_', ''), '+', ',') as flux, round(box.value, 1) as tolles_lawson,
       round(pls, 1) as pls, round(ridge, 1) as ridge, round(m1, 1) as m1, round(m2c, 1) as m2c, round(etlnn, 1) as etlnn
from linear join network on linear.mag = network.mag and linear.vectors = network.vectors join box on box.mag = linear.mag
order by linear.mag, length(linear.vectors), linear.vectors

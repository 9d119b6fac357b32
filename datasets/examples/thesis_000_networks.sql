-- Standard deviation in nT, pooled over the test lines: one magnetometer with one or two vector magnetometers, then the small
-- feature sets with Flux A.
with box as (select mag, min(value) as value from thesis_000_networks.box where metric = 'std_error' group by mag),
linear as (
    select mag, vectors as inputs, linear, value from thesis_000_networks.linear where metric = 'std_error'
    union all select mag, "set", linear, value from thesis_000_networks.small_linear where metric = 'std_error'
),
network as (
    select mag, vectors as inputs, model, value from thesis_000_networks.network where metric = 'std_error'
    union all select mag, vectors, 'm1', value from thesis_000_networks.m1 where metric = 'std_error'
    union all select mag, "set", 'm2c', value from thesis_000_networks.small_network where metric = 'std_error'
),
linear_wide as (
    select mag, inputs, max(case when linear = 'pls' then value end) as pls, max(case when linear = 'ridge' then value end) as ridge
    from linear group by mag, inputs
),
network_wide as (
    select mag, inputs, max(case when model = 'm1' then value end) as m1, max(case when model = 'm2c' then value end) as m2c,
           max(case when model = 'etlnn' then value end) as etlnn
    from network group by mag, inputs
)
select l.mag, replace(replace(l.inputs, 'TL_A_flux_', ''), '+', ',') as features, round(box.value, 1) as tolles_lawson,
       round(pls, 1) as pls, round(ridge, 1) as ridge, round(m1, 1) as m1, round(m2c, 1) as m2c, round(etlnn, 1) as etlnn
from linear_wide l join network_wide n on l.mag = n.mag and l.inputs = n.inputs join box on box.mag = l.mag
order by l.mag, length(l.inputs), l.inputs

-- Standard deviation in nT, pooled over the test lines; for networks, the median over the seeds and the range. First one
-- magnetometer with one or two vector magnetometers, then the small feature sets with Flux A. `m2c_all` has all features as
-- linear terms. `kept` is the smallest anomaly retention of all models except Tolles-Lawson on the box; it is empty if the
-- true anomaly is unknown.
with box as (select mag, min(value) as value from thesis_000_networks.box where metric = 'std_error' group by mag),
linear as (
    select mag, vectors as inputs, linear, metric, value from thesis_000_networks.linear
    union all select mag, "set", linear, metric, value from thesis_000_networks.small_linear
),
network as (
    select mag, vectors as inputs, model, metric, value from thesis_000_networks.network
    union all select mag, vectors, 'm1', metric, value from thesis_000_networks.m1
    union all select mag, vectors, 'wide', metric, value from thesis_000_networks.wide
    union all select mag, "set", 'm2c', metric, value from thesis_000_networks.small_network
),
linear_wide as (
    select mag, inputs, max(case when linear = 'pls' then value end) as pls, max(case when linear = 'ridge' then value end) as ridge
    from linear where metric = 'std_error' group by mag, inputs
),
network_wide as (
    select mag, inputs,
           median(case when model = 'm1' then value end) as m1, max(case when model = 'm1' then value end) - min(case when model = 'm1' then value end) as m1_spread,
           median(case when model = 'm2c' then value end) as m2c, max(case when model = 'm2c' then value end) - min(case when model = 'm2c' then value end) as m2c_spread,
           median(case when model = 'wide' then value end) as wide, max(case when model = 'wide' then value end) - min(case when model = 'wide' then value end) as wide_spread,
           median(case when model = 'etlnn' then value end) as etlnn, max(case when model = 'etlnn' then value end) - min(case when model = 'etlnn' then value end) as etlnn_spread
    from network where metric = 'std_error' group by mag, inputs
),
kept as (
    select mag, inputs, min(value) as kept from (
        select mag, inputs, metric, value from linear union all select mag, inputs, metric, value from network
    ) where metric = 'anomaly_retention' group by mag, inputs
)
select l.mag, replace(replace(l.inputs, 'TL_A_flux_', ''), '+', ',') as features, round(box.value, 1) as tolles_lawson,
       round(pls, 1) as pls, round(ridge, 1) as ridge, round(m1, 1) as m1, round(m1_spread, 1) as m1_spread,
       round(m2c, 1) as m2c, round(m2c_spread, 1) as m2c_spread, round(wide, 1) as m2c_all, round(wide_spread, 1) as m2c_all_spread,
       round(etlnn, 1) as etlnn, round(etlnn_spread, 1) as etlnn_spread,
       round(kept, 2) as kept
from linear_wide l join network_wide n on l.mag = n.mag and l.inputs = n.inputs join box on box.mag = l.mag
     left join kept on kept.mag = l.mag and kept.inputs = l.inputs
order by l.mag, length(l.inputs), l.inputs

-- Standard deviation in nT, pooled over the test lines; for networks, the median over ten seeds. First one magnetometer with
-- one or two vector magnetometers, then the small feature sets with Flux A. `m2c_all` has all features as linear terms.
--
-- The columns `_low` and `_high` are the second smallest and the second largest value: a 97.9 % interval of the median of ten
-- seeds. `_better` counts the seeds with a smaller error than PLS; 9 or 10 of ten, or 0 or 1, are significant at 5 %.
-- `kept` is the smallest anomaly retention of all models except Tolles-Lawson on the box; it is empty if the true anomaly is
-- unknown.
with box as (select mag, min(value) as value from gnadt_2022_networks.box where metric = 'std_error' group by mag),
linear as (
    select mag, vectors as inputs, linear, metric, value from gnadt_2022_networks.linear
    union all select mag, "set", linear, metric, value from gnadt_2022_networks.small_linear
),
network as (
    select mag, vectors as inputs, model, metric, value from gnadt_2022_networks.network
    union all select mag, vectors, 'm1', metric, value from gnadt_2022_networks.m1
    union all select mag, vectors, 'wide', metric, value from gnadt_2022_networks.wide
    union all select mag, "set", 'm2c', metric, value from gnadt_2022_networks.small_network
),
linear_wide as (
    select mag, inputs, max(case when linear = 'pls' then value end) as pls, max(case when linear = 'ridge' then value end) as ridge
    from linear where metric = 'std_error' group by mag, inputs
),
ranked as (
    select n.mag, n.inputs, n.model, n.value, case when n.value < l.pls then 1 else 0 end as better_than_pls,
           row_number() over (partition by n.mag, n.inputs, n.model order by n.value) as place,
           count(*) over (partition by n.mag, n.inputs, n.model) as seeds
    from network n join linear_wide l on l.mag = n.mag and l.inputs = n.inputs where n.metric = 'std_error'
),
cells as (
    select mag, inputs, model, round(median(value), 1) as mid, round(max(case when place = 2 then value end), 1) as low,
           round(max(case when place = seeds - 1 then value end), 1) as high, sum(better_than_pls) as better
    from ranked group by mag, inputs, model
),
kept as (
    select mag, inputs, min(value) as kept from (
        select mag, inputs, metric, value from linear union all select mag, inputs, metric, value from network
    ) where metric = 'anomaly_retention' group by mag, inputs
)
select l.mag, replace(replace(l.inputs, 'TL_A_flux_', ''), '+', ',') as features, round(box.value, 1) as tolles_lawson,
       round(pls, 1) as pls, round(ridge, 1) as ridge,
       m1.mid as m1, m1.low as m1_low, m1.high as m1_high, m1.better as m1_better,
       m2c.mid as m2c, m2c.low as m2c_low, m2c.high as m2c_high, m2c.better as m2c_better,
       wide.mid as m2c_all, wide.low as m2c_all_low, wide.high as m2c_all_high, wide.better as m2c_all_better,
       etlnn.mid as etlnn, etlnn.low as etlnn_low, etlnn.high as etlnn_high, etlnn.better as etlnn_better,
       round(kept, 2) as kept
from linear_wide l join box on box.mag = l.mag
     left join cells m1 on m1.model = 'm1' and m1.mag = l.mag and m1.inputs = l.inputs
     left join cells m2c on m2c.model = 'm2c' and m2c.mag = l.mag and m2c.inputs = l.inputs
     left join cells wide on wide.model = 'wide' and wide.mag = l.mag and wide.inputs = l.inputs
     left join cells etlnn on etlnn.model = 'etlnn' and etlnn.mag = l.mag and etlnn.inputs = l.inputs
     left join kept on kept.mag = l.mag and kept.inputs = l.inputs
order by l.mag, length(l.inputs), l.inputs

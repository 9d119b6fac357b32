-- DRMS in m of an EKF with model 2c and of networks trained in flight, for the magnetometers and noise of the published
-- tables. It is the root mean square over the INS realisations; for networks, the median over ten seeds. The columns `_low`
-- and `_high` are the second smallest and the second largest value: a 97.9 % interval of the median.
with compensated as (
    select mag, "set" as features, seed, line, sqrt(avg(value * value)) as value from gnadt_2022_network_navigation.network_scores
    where metric = 'drms' and ((mag = 'mag_3_uc' and sigma > 50) or (mag = 'mag_4_uc' and sigma between 20 and 50) or (mag = 'mag_5_uc' and sigma < 20))
    group by mag, "set", seed, line
),
left_nt as (
    select mag, "set" as features, seed, line, avg(value) as value from gnadt_2022_network_navigation.network_scores
    where metric = 'std_error' group by mag, "set", seed, line
),
trained as (
    select mag, "set" as features, seed, line, sqrt(avg(value * value)) as value from gnadt_2022_network_navigation.online_network_scores
    where metric = 'drms' group by mag, "set", seed, line
),
raw as (
    select mag, line, sqrt(avg(value * value)) as drms from gnadt_2022_network_navigation.online_raw_scores
    where metric = 'drms' group by mag, line
),
figures as (
    select 'error_nt' as figure, * from left_nt
    union all select 'ekf_2c', * from compensated
    union all select 'online_of_2c', * from trained
),
ranked as (
    select *, row_number() over (partition by figure, mag, features, line order by value) as place,
           count(*) over (partition by figure, mag, features, line) as seeds
    from figures
),
cells as (
    select figure, mag, features, line, round(median(value), 1) as value, round(max(case when place = 2 then value end), 1) as low,
           round(max(case when place = seeds - 1 then value end), 1) as high
    from ranked group by figure, mag, features, line
)
select e.mag, e.features, e.line, e.value as error_nt, e.low as error_nt_low, e.high as error_nt_high,
       c.value as ekf_2c, c.low as ekf_2c_low, c.high as ekf_2c_high,
       t.value as online_of_2c, t.low as online_of_2c_low, t.high as online_of_2c_high, round(raw.drms, 1) as online_of_raw
from cells e join cells c on c.figure = 'ekf_2c' and e.mag = c.mag and e.features = c.features and e.line = c.line
     join cells t on t.figure = 'online_of_2c' and e.mag = t.mag and e.features = t.features and e.line = t.line
     join raw on raw.mag = e.mag and raw.line = e.line
where e.figure = 'error_nt' order by e.mag, e.features, e.line

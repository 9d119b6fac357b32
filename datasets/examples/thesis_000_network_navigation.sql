-- DRMS in m of an EKF with model 2c and of networks trained in flight, for the magnetometers and noise of the published
-- tables. It is the root mean square over the INS realisations; for model 2c, the median over the seeds of the network.
with compensated as (
    select mag, "set" as features, seed, line, sqrt(avg(value * value)) as drms from thesis_000_network_navigation.network_scores
    where metric = 'drms' and ((mag = 'mag_3_uc' and sigma > 50) or (mag = 'mag_4_uc' and sigma between 20 and 50) or (mag = 'mag_5_uc' and sigma < 20))
    group by mag, "set", seed, line
),
left_nt as (
    select mag, "set" as features, line, median(value) as error_nt from thesis_000_network_navigation.network_scores
    where metric = 'std_error' group by mag, "set", line
),
trained as (
    select mag, "set" as features, seed, line, sqrt(avg(value * value)) as drms from thesis_000_network_navigation.online_network_scores
    where metric = 'drms' group by mag, "set", seed, line
),
raw as (
    select mag, line, sqrt(avg(value * value)) as drms from thesis_000_network_navigation.online_raw_scores
    where metric = 'drms' group by mag, line
)
select c.mag, c.features, c.line, round(min(n.error_nt), 1) as error_nt, round(median(c.drms), 1) as ekf_2c,
       round(median(t.drms), 1) as online_of_2c, round(min(raw.drms), 1) as online_of_raw
from compensated c join trained t on c.mag = t.mag and c.features = t.features and c.seed = t.seed and c.line = t.line
     join left_nt n on n.mag = c.mag and n.features = c.features and n.line = c.line
     join raw on raw.mag = c.mag and raw.line = c.line
group by c.mag, c.features, c.line order by c.mag, c.features, c.line

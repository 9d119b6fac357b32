-- Error in nT of model 2c, and DRMS in m of an EKF with it (`ekf`) and of a network trained in flight (`online`), over ten
-- seeds of `gnadt_2022_network_navigation.toml`: median, second smallest and second largest.
with compensated as (
    select mag, "set" as features, seed, line, sqrt(avg(value * value)) as drms from gnadt_2022_network_navigation.network_scores
    where metric = 'drms' and ((mag = 'mag_3_uc' and sigma > 50) or (mag = 'mag_4_uc' and sigma between 20 and 50) or (mag = 'mag_5_uc' and sigma < 20))
    group by mag, "set", seed, line
), trained as (
    select mag, "set" as features, seed, line, sqrt(avg(value * value)) as drms from gnadt_2022_network_navigation.online_network_scores
    where metric = 'drms' group by mag, "set", seed, line
), nt as (
    select mag, "set" as features, seed, line, min(value) as e from gnadt_2022_network_navigation.network_scores
    where metric = 'std_error' group by mag, "set", seed, line
), a as (
 select 'nt' as k, mag, features, line, e as v from nt union all select 'ekf', mag, features, line, drms from compensated union all select 'online', mag, features, line, drms from trained
), r as (select *, row_number() over (partition by k, mag, features, line order by v) as i from a)
select mag, features, line, k, round(median(v),1) as m, round(max(case when i=2 then v end),1) as lo, round(max(case when i=9 then v end),1) as hi
from r where (mag='mag_3_uc') or (mag='mag_5_uc' and features='small_2') or (mag='mag_4_uc' and features='small_1' and line='1007.06') group by mag, features, line, k order by mag, features, line, k

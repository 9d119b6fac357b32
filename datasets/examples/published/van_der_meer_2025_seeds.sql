-- Improvement ratio and overfitting ratio of the networks of `van_der_meer_2025_networks.toml` over ten seeds: median, second smallest
-- and second largest. Means over the test manoeuvres of each flight, then over flights.
with scores as (
    select 'left' as wing, "left" as sensor, sortie, linear, inputs, seed, line, metric, value from van_der_meer_2025_networks.left_network
    union all select 'right', "right", sortie, linear, inputs, seed, line, metric, value from van_der_meer_2025_networks.right_network
), f as (
    select wing, sensor, sortie, linear, inputs, seed,
           avg(case when metric = 'improvement_ratio' and line not in ('1', '5', '7') then value end) as ratio,
           avg(case when metric = 'std_error' and line not in ('1', '5', '7') then value end)
               / avg(case when metric = 'std_error' and line in ('1', '5', '7') then value end) as over
    from scores group by wing, sensor, sortie, linear, inputs, seed
), s as (select wing, sensor, linear, inputs, seed, avg(ratio) as ratio, avg(over) as over from f group by wing, sensor, linear, inputs, seed),
r as (select *, row_number() over (partition by wing, sensor, linear, inputs order by ratio) as i, row_number() over (partition by wing, sensor, linear, inputs order by over) as j from s)
select sensor, case when linear = 'core' then 'TL' else 'ETL' end as linear,
       case when inputs like 'rcou_c1_1%' then 'FS1' when inputs like 'rcou_c2_3%cur_batt_2' then 'FStop50' when inputs like 'rcou_c2_3%' then 'FStop10' else 'FS0' end as network,
       count(*) as n, round(median(ratio),2) as m, round(max(case when i=2 then ratio end),2) as lo, round(max(case when i=9 then ratio end),2) as hi,
       round(median(over),2) as om, round(max(case when j=2 then over end),2) as olo, round(max(case when j=9 then over end),2) as ohi
from r group by sensor, linear, inputs order by sensor, linear desc, network

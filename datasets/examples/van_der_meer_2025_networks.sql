-- Mean improvement ratio over the test manoeuvres of each flight; overfitting ratio, the standard deviation on test divided
-- by that on calibration manoeuvres; mean anomaly retention on test manoeuvres. Linear models (`inputs` -) come first, then
-- networks.
with scores as (
    select 'left' as wing, "left" as sensor, sortie, linear, '-' as inputs, 0 as epochs, line, metric, value from van_der_meer_2025_networks.left_linear
    union all select 'right', "right", sortie, linear, '-', 0, line, metric, value from van_der_meer_2025_networks.right_linear
    union all select 'left', "left", sortie, linear, inputs, epochs, line, metric, value from van_der_meer_2025_networks.left_network
    union all select 'right', "right", sortie, linear, inputs, epochs, line, metric, value from van_der_meer_2025_networks.right_network
), of_flight as (
    select wing, sensor, sortie, linear, inputs, epochs,
           avg(case when metric = 'improvement_ratio' and line not in ('1', '5', '7') then value end) as ratio,
           avg(case when metric = 'std_error' and line not in ('1', '5', '7') then value end)
               / avg(case when metric = 'std_error' and line in ('1', '5', '7') then value end) as overfitting,
           avg(case when metric = 'anomaly_retention' and line not in ('1', '5', '7') then value end) as kept
    from scores group by wing, sensor, sortie, linear, inputs, epochs
)
select wing, sensor, case when linear = 'core' then 'TL' else 'ETL' end as linear,
       case when inputs = '-' then '-' when inputs like 'rcou_c1_1%' then 'FS1' when inputs like 'rcou_c2_3%cur_batt_2' then 'FStop50'
            when inputs like 'rcou_c2_3%' then 'FStop10' else 'FS0' end as network, epochs,
       round(avg(ratio), 2) as improvement, round(avg(overfitting), 2) as overfitting, round(avg(kept), 2) as kept
from of_flight group by wing, sensor, linear, inputs, epochs order by wing, sensor, linear desc, epochs, network

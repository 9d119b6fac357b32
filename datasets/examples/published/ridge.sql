-- Standard deviation of the error in nT by ridge parameter and number of terms, mean over the calibrations.
select ridge, round(avg(case when terms = 'permanent+induced' then value end), 1) as terms_9,
       round(avg(case when terms = 'permanent+induced+eddy' then value end), 1) as terms_18,
       round(avg(case when terms like '%bias' then value end), 1) as terms_19
from ridge.scores group by ridge order by ridge

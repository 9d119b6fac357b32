"""Makes sgl_2020.h5 from Flt1003_sample.xyz, with the data sets that MagNav.jl's xyz2h5 writes.

python3 make_sgl_hdf5.py   (h5py 3.x, numpy)

Columns without any value in the nine rows are left out, as in flights that lack a sensor. Some data sets are
chunked and deflated, some contiguous, some single precision, so that a reader meets all of them.
"""
import h5py
import numpy as np

NAMES = """line flight year doy tt utm_x utm_y utm_z msl lat lon baro radar topo dem drape ins_pitch ins_roll ins_yaw
diurnal mag_1_c mag_1_lag mag_1_dc mag_1_igrf mag_1_uc mag_2_uc mag_3_uc mag_4_uc mag_5_uc
flux_a_x flux_a_y flux_a_z flux_a_t flux_b_x flux_b_y flux_b_z flux_b_t
flux_c_x flux_c_y flux_c_z flux_c_t flux_d_x flux_d_y flux_d_z flux_d_t ogs_mag ogs_alt
ins_acc_x ins_acc_y ins_acc_z ins_wander ins_lat ins_lon ins_alt ins_vn ins_vw ins_vu pitch_rate roll_rate yaw_rate
lgtl_acc ltrl_acc nrml_acc tas pitot_p static_p total_p cur_com_1 cur_ac_hi cur_ac_lo cur_tank cur_flap cur_strb
cur_srvo_o cur_srvo_m cur_srvo_i cur_heat cur_acpwr cur_outpwr cur_bat_1 cur_bat_2 vol_acpwr vol_outpwr vol_bat_1
vol_bat_2 vol_res_p vol_res_n vol_back_p vol_back_n vol_gyro_1 vol_gyro_2 vol_acc_p vol_acc_n vol_block vol_back
vol_srvo vol_cabt vol_fan""".split()

rows = [line.split() for line in open("Flt1003_sample.xyz") if line.strip() and not line.startswith("/")]
table = np.array([[np.nan if word == "*" else float(word) for word in row] for row in rows])
assert table.shape[1] == len(NAMES), (table.shape, len(NAMES))
with h5py.File("sgl_2020.h5", "w", track_order=False) as out:
    out["N"] = len(table)
    out["dt"] = 0.1
    for i, (name, column) in enumerate(zip(NAMES, table.T)):
        if np.isnan(column).all():
            continue
        if name.startswith("vol_"):
            out.create_dataset(name, data=column.astype("f4"), track_times=False)
        elif i % 3 == 0:
            out.create_dataset(name, data=column, chunks=(4,), compression="gzip", shuffle=True, track_times=False)
        else:
            out.create_dataset(name, data=column, track_times=False)

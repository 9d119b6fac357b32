-- The columns that `sgl_xyz.py` writes.
select flight, line, tt, year, doy, lat, lon, alt, ins_pitch, ins_roll, ins_yaw, diurnal, igrf, mag_1_c, mag_4_uc, mag_5_uc,
       flux_d_x, flux_d_y, flux_d_z, ins_fn, ins_fe, ins_fd, ins_lat, ins_lon, ins_alt, ins_vn, ins_ve, ins_vd, cur_com_1,
       cur_ac_hi, cur_ac_lo, cur_tank, cur_flap, cur_strb, cur_srvo_o, cur_srvo_m, cur_srvo_i, cur_heat, cur_acpwr
from sgl_lines.even order by flight, line, tt

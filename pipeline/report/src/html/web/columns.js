// @ts-check
"use strict";
// Columns of a line: presets, panels, colours.

/**
 * @typedef {{table: string, column: string}} ColumnChoice
 * @typedef {{key: string, title: string, unit: string, items: ColumnChoice[], bands: [ColumnChoice, ColumnChoice][]}}
 *   PanelPlan
 * @typedef {{name: string, title: string, find: (columns: ColumnInfo[], point: SweepPoint) => string[]}} PanelPreset
 */

/** Sigma columns and the errors whose panel shows their band. */
const SIGMAS = { sd_n: "north_error", sd_e: "east_error" };

/** Titles of panels whose columns share no panel with others of their unit. */
const FAMILIES = [
  { title: "Position error, north", names: ["north_error", "sd_n", "ins_north_error"] },
  { title: "Position error, east", names: ["east_error", "sd_e", "ins_east_error"] },
  { title: "Error of the field", names: ["error"] },
  { title: "Innovation", names: ["residual", "innovation"] },
  { title: "Field of the aircraft", names: ["mag_aircraft"] },
  { title: "Roll and pitch", names: ["roll", "pitch", "ins_roll", "ins_pitch"] },
  { title: "Heading", names: ["yaw", "ins_yaw"] },
];

/** Usual titles of units. */
const UNIT_TITLES = { nT: "Magnetic field", A: "Current", V: "Voltage", deg: "Angle", "m/s": "Velocity", m: "Length",
  "m/s2": "Specific force" };

/** @param {ColumnInfo[]} columns @param {string[]} names */
const present = (columns, names) => names.filter((name) => columns.some((c) => c.name === name && c.series));

/** The uncompensated magnetometer of a point, or the first. @param {ColumnInfo[]} columns @param {SweepPoint} point */
function uncompensated(columns, point) {
  const all = columns.filter((c) => c.series && c.unit === "nT" && /^mag_[a-z0-9]+_uc$/.test(c.name))
    .map((c) => c.name);
  return all.find((name) => Object.values(point).includes(name)) ?? all[0];
}

/** @type {PanelPreset[]} */
const PRESETS = [
  { name: "navigation", title: "Navigation", find: (columns) => {
    const errors = present(columns, ["north_error", "sd_n", "east_error", "sd_e", "residual"]);
    return errors.length ? [...errors, ...present(columns, ["roll", "pitch"])] : [];
  } },
  { name: "compensation", title: "Compensation", find: (columns, point) => {
    const own = present(columns, ["mag_c"]);
    if (!own.length) return [];
    const truth = columns.find((c) => c.series && c.role === "truth" && /^mag_[a-z0-9]+_c$/.test(c.name));
    return [uncompensated(columns, point), ...own, truth?.name, ...present(columns, ["error"])]
      .filter((name) => name !== undefined);
  } },
  { name: "drift", title: "INS drift", find: (columns) => {
    const drift = present(columns, ["ins_north_error", "ins_east_error"]);
    return drift.length ? [...drift, ...present(columns, ["north_error", "east_error"])] : [];
  } },
  { name: "currents", title: "Currents", find: (columns) =>
    columns.filter((c) => c.series && /^(cur|vol)_/.test(c.name)).map((c) => c.name).slice(0, 8) },
  { name: "attitude", title: "Attitude", find: (columns) => present(columns, ["roll", "pitch", "yaw"]) },
];

/** Columns of a preset: from the table with most of them. @param {PanelPreset} preset @param {TableInfo[]} tables
 * @param {SweepPoint} point @returns {ColumnChoice[]} */
function presetColumns(preset, tables, point) {
  /** @type {ColumnChoice[]} */
  let best = [];
  for (const { name, columns } of tables) {
    const found = preset.find(columns, point).map((column) => ({ table: name, column }));
    if (found.length > best.length) best = found;
  }
  return best;
}

/** Panels of the chosen columns: one for each unit and family, or one for each column.
 * @param {ColumnChoice[]} chosen @param {(choice: ColumnChoice) => ColumnInfo | undefined} info @param {boolean} each
 * @returns {PanelPlan[]} */
function panelPlans(chosen, info, each) {
  /** @type {Map<string, PanelPlan>} */
  const plans = new Map();
  const has = (/** @type {string} */ name) => chosen.find((c) => c.column === name);
  for (const choice of chosen) {
    const found = info(choice);
    if (!found) continue;
    const unit = found.unit || "1", base = choice.column.replace(/\[\d+\]$/, "");
    const error = has(SIGMAS[/** @type {keyof typeof SIGMAS} */ (base)] ?? "");
    const family = FAMILIES.find((f) => f.names.includes(error?.column ?? base));
    const key = each ? `${choice.table}/${error?.column ?? choice.column}` : `${unit}/${family?.title ?? ""}`;
    const title = each ? error?.column ?? choice.column : family?.title ??
      UNIT_TITLES[/** @type {keyof typeof UNIT_TITLES} */ (unit)] ?? base;
    const plan = plans.get(key) ?? { key, title, unit, items: [], bands: [] };
    if (error) plan.bands.push([choice, error]); else plan.items.push(choice);
    plans.set(key, plan);
  }
  return [...plans.values()];
}

/** Colour and dash of a column by its meaning, or by its place.
 * @param {ColumnInfo | undefined} info @param {number} k */
function columnStyle(info, k) {
  const name = info?.name ?? "";
  const dash = k > 7 ? [3, 3] : [];
  if (/^mag_[a-z0-9]+_uc$/.test(name) && k === 0) return { hue: "--before", dash };
  if (name === "mag_c" || name === "error") return { hue: "--after", dash };
  if (info?.role === "truth" && info.unit === "nT") return { hue: "--ink", dash: [5, 4] };
  if (name.startsWith("ins_")) return { hue: "--ins", dash };
  return { hue: `--s${k % 8}`, dash };
}

/** Columns as text of the address. @param {ColumnChoice[]} columns */
function columnsText(columns) {
  return columns.map((c) => encodeURIComponent(c.table) + "/" + encodeURIComponent(c.column)).join(",");
}

/** Columns from text of the address. @param {string} text @returns {ColumnChoice[]} */
function columnsFrom(text) {
  return text.split(",").flatMap((one) => {
    try {
      const [table, column] = one.split("/").map(decodeURIComponent);
      return column === undefined ? [] : [{ table, column }];
    } catch { return []; }
  });
}

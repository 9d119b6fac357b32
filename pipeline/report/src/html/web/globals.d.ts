// Types of the vendored scripts, as far as the page uses them.

interface ArrowField { name: string; metadata: Map<string, string> | null }
interface ArrowColumn { length: number; nullCount: number; toArray(): ArrayLike<number | null> }
interface ArrowTable {
  schema: { fields: ArrowField[]; metadata: Map<string, string> | null };
  numRows: number;
  getChildAt(index: number): ArrowColumn;
}
declare const fl: { tableFromIPC(bytes: Uint8Array): ArrowTable };

type PlotColumn = Float64Array | (number | null)[];
interface PlotInstance {
  root: HTMLElement; over: HTMLElement; width: number; height: number; data: PlotColumn[];
  scales: Record<string, { min?: number; max?: number }>;
  series: { show?: boolean; label?: string; scale?: string }[];
  select: { left: number; width: number };
  cursor: { left?: number; top?: number; idx?: number | null };
  bbox: { left: number; top: number; width: number; height: number };
  setData(data: PlotColumn[], rescale?: boolean): void;
  setScale(key: string, range: { min: number; max: number }): void;
  setSize(size: { width: number; height: number }): void;
  setSelect(select: { left: number; top: number; width: number; height: number }, fire?: boolean): void;
  setCursor(at: { left: number; top: number }): void;
  setSeries(at: number, options: { show: boolean }): void;
  posToVal(at: number, scale: string): number;
  valToPos(value: number, scale: string): number;
  valToIdx(value: number): number;
  batch(act: () => void): void;
  redraw(paths?: boolean, axes?: boolean): void;
  destroy(): void;
}
declare const uPlot: {
  new(options: object, data: PlotColumn[], home: HTMLElement): PlotInstance;
  rangeNum(low: number, high: number, pad: number, extra: boolean): [number, number];
};

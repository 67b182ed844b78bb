// The service's JSON, as docs/api.md has it. What is not known is absent.

export type Matrix = number[][];

export interface Estimate {
  session?: string;
  epoch?: number;
  target: string;
  frame: number;
  capture_ns?: number;
  publish_ns?: number;
  time_s?: number;
  dropped: number;
  model: string;
  state: "searching" | "tracking" | "coasting" | "lost";
  parameters: Record<string, number>;
  order: string[];
  covariance?: Matrix;
  objective?: number;
  reduced_chi_square?: number;
  noise_ratio?: number;
  confidence?: number;
  pixels: number;
  saturated: number;
  iterations: number[];
  converged: boolean;
  ending: string;
  rejection?: string;
  quality?: Quality[];
  illumination?: { background?: number; brightness?: number };
  pose?: { position_mm: number[]; orientation_xyzw: number[]; covariance?: number[] };
  exposure_advice?: { factor: number; goal: string; why: string };
  substitute?: { degree?: number; robust?: boolean; hidden?: number };
  at_bounds?: string[];
  strongest?: { score: number; threshold: number; place: number[]; size_px: number };
  timing_us?: { wait?: number; fit: number };
}

/** A shortcoming of a fit. */
export interface Quality {
  code: string;
  sigma?: number;
  share?: number;
  place?: number[];
  parameters?: string[];
  factor?: number;
}

export interface Session {
  name: string;
  source: string | Record<string, unknown>;
  model: string;
  state: "starting" | "running" | "stalled" | "lost_source" | "stopped" | "failed";
  reason?: string;
  requested_model: string;
  active_model: string;
  active_digest: string;
  active_since_frame: number;
  frames: number;
  dropped: number;
  rate_hz: number;
  over_budget?: number;
  frame_budget_ms?: number;
  cost_ms?: number;
  shadow?: {
    model: string;
    state: string;
    reason?: string;
    frames: number;
    dropped: number;
    last?: { estimate: Estimate; centre_px?: number; parameters?: Record<string, { difference: number; deviations?: number }> };
  };
  recording?: { state: "recording" | "ended" | "failed"; reason?: string; files: string[]; recorded_frames: number; bytes: number; dropped: number };
  exposure_control?: { held: boolean; reason?: string };
  options?: { exposure?: { goal?: string; control?: boolean } };
}

export interface Source {
  name: string;
  kind: "synthetic" | "recording" | "pushed" | "camera";
  state: string;
  reason?: string;
  frames: number;
  sessions: number;
  [key: string]: unknown;
}

export interface ModelItem { name: string; version: number; digest: string; description: string; parameters: string[] }

/** A model's document as JSON; of what is in it, only what the page reads. */
export interface ModelDocument {
  name: string;
  version: number;
  digest: string;
  description?: string;
  coordinates: string[];
  channels: string[];
  parameters: Record<string, { unit?: string; min?: number; max?: number; start?: unknown }>;
  constants?: Record<string, number>;
  definitions?: Record<string, string>;
  roles?: Record<string, unknown>;
  stages?: { parameters: string[]; method?: string }[];
}

export interface Diagnostic {
  severity: string;
  code: string;
  message: string;
  help?: string;
  key?: string;
  line?: number;
  column?: number;
  span?: [number, number];
}

export interface StageFigures {
  parameters: string[];
  method: string;
  flops_per_pixel: number;
  accumulators: number;
  flops_per_row: number;
  flops_per_pass: number;
  calls: Record<string, number>;
  compile_ms: number;
}

/** What a loop costs a pixel. */
export interface BodyCost { flops_per_pixel: number; ns_per_pixel?: number }

export interface LoopCost { sums: "gradient" | "hessian" | "joint"; differentiated?: BodyCost; compiled?: BodyCost }

export interface Explanation extends StageFigures {
  model: string;
  digest: string;
  show: string;
  text: string;
  lines?: { value?: number; span?: [number, number] }[];
  loops?: LoopCost[];
}

/** What stands before the pixels of a preview's message. */
export interface PreviewHead {
  frame: number;
  epoch?: number;
  part: "frame" | "window" | "residual";
  format: "raw8" | "raw16" | "jpeg";
  width: number;
  height: number;
  origin: [number, number];
  step: number;
  levels: { low: number; high: number };
  frame_size: [number, number];
  /** z, or z and w, of a stack. */
  slice?: number[];
  window?: { x: number; y: number; width: number; height: number };
  estimate?: Estimate;
  estimates?: Estimate[];
  /** The edge of the domain, or the half maximum. */
  contour?: [number, number][][];
  /** s = 1, of models that have it. */
  outline?: [number, number][][];
  /** Of model and sigma, null outside of the domain. */
  section?: { y: number; x: number[]; observed: number[]; model?: (number | null)[]; sigma?: (number | null)[]; saturation?: number };
  saturated?: [number, number, number][];
  saturated_cut?: boolean;
  axes?: { axis: string; from: [number, number]; to: [number, number] }[];
}

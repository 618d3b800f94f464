/** The server's HTTP interface, as far as the page needs it. */

import { admit, authorization } from './access';
import { answerFrom, embedded } from './embedded';

export type State = 'initialising' | 'tracked' | 'weak' | 'lost';

export interface Session {
  id: string;
  camera: { width: number; height: number };
  created_at_ns: number;
  state: State | null;
  metres_per_unit: number | null;
  n_frames: number;
  n_keyframes: number;
  n_points: number;
  n_lines: number;
  n_primitives: number;
  n_submaps: number;
  durable_sequence: number | null;
  /** How long the camera takes to read the rows of an image, where the session has found that. */
  found_readout?: { readout_ms: number; sigma_ms: number } | null;
  loaded: boolean;
  has_writer: boolean;
}

export interface SessionPage {
  sessions: Session[];
  next_page_token: string | null;
}

/** What was measured in an image, in pixels of an image of `width` by `height`. */
export interface Observed {
  width: number;
  height: number;
  keypoints: [number, number][];
  point_ids: (number | null)[];
  segments: [number, number, number, number][];
  line_ids: (number | null)[];
  primitive_ids: (number | null)[];
  vanishing_idx: (number | null)[];
  vanishing_points: { pixel: [number, number] | null; primitive_id: number | null; n_segments: number }[];
}

export interface Edge {
  from: number;
  to: number;
  weight: number;
  n_points: number;
  n_lines: number;
}

/** Work on a whole map, which goes on whether or not somebody looks. */
export interface Operation {
  id: string;
  kind: 'optimize' | 'merge';
  session_id: string;
  from_session_id: string | null;
  state: 'queued' | 'running' | 'done' | 'failed' | 'cancelled';
  /** Share that is done, 0 to 1. */
  progress: number;
  message: string;
}

/** An answer that is an error, with the server's sentence. */
export class ApiProblem extends Error {
  constructor(
    readonly status: number,
    detail: string,
  ) {
    super(detail);
  }
}

/** The server could not be reached. */
export class ServerAway extends Error {
  constructor() {
    super('The server does not answer.');
  }
}

async function answer(path: string, init: RequestInit): Promise<Response> {
  try {
    if (embedded) return answerFrom(embedded, path);
    return await fetch(path, { ...init, headers: { ...(init.headers as Record<string, string> | undefined), ...authorization() } });
  } catch (error) {
    if (error instanceof DOMException && error.name === 'AbortError') throw error;
    throw new ServerAway();
  }
}

/** Sends a request; an answer that is an error is thrown as {@link ApiProblem}. */
export async function request(path: string, init: RequestInit = {}): Promise<Response> {
  let response = await answer(path, init);
  if (response.status === 401 && !embedded) {
    await admit();
    response = await answer(path, init);
  }
  if (!response.ok) {
    const problem: unknown = await response.json().catch(() => null);
    const detail = (problem as { detail?: string } | null)?.detail;
    throw new ApiProblem(response.status, detail ?? `The server answered ${response.status}.`);
  }
  return response;
}

async function json<T>(path: string, signal?: AbortSignal): Promise<T> {
  const response = await request(path, signal ? { signal } : {});
  return (await response.json()) as T;
}

export const sessionPath = (id: string) => `/v1/sessions/${encodeURIComponent(id)}`;

export const listSessions = (pageToken: string, signal?: AbortSignal) =>
  json<SessionPage>(`/v1/sessions?page_size=100&page_token=${encodeURIComponent(pageToken)}`, signal);
export const getSession = (id: string) => json<Session>(sessionPath(id));
export const getObserved = (path: string, signal: AbortSignal) => json<Observed>(`${path}/observed`, signal);

/** Pairs of keyframes that share at least so many landmarks; with `keyframe`, its pairs only. */
export async function getEdges(id: string, minWeight: number, keyframe?: number): Promise<Edge[]> {
  const only = keyframe === undefined ? '' : `&keyframe_id=${keyframe}`;
  const graph = await json<{ edges: Edge[] }>(`${sessionPath(id)}/graph?min_weight=${minWeight}${only}`);
  return graph.edges;
}

async function post<T>(path: string, body?: unknown): Promise<T> {
  const sent = body === undefined ? {} : { headers: { 'content-type': 'application/json' }, body: JSON.stringify(body) };
  const response = await request(path, { method: 'POST', ...sent });
  return (await response.json()) as T;
}

/** Says how many metres a map unit is; `null` frees the scale. */
export const setScale = (id: string, metresPerUnit: number | null) =>
  post<Session>(`${sessionPath(id)}/scale`, { metres_per_unit: metresPerUnit });

export const beginOptimize = (id: string) => post<Operation>(`${sessionPath(id)}/optimize`);
export const beginMerge = (id: string, from: string) => post<Operation>(`${sessionPath(id)}/merge`, { from });
export const cancelOperation = (operation: string) =>
  post<Operation>(`/v1/operations/${encodeURIComponent(operation)}/cancel`);

/** Operations on a session, the newest first. */
export async function listOperations(id: string): Promise<Operation[]> {
  const { operations } = await json<{ operations: Operation[] }>(`/v1/operations?session=${encodeURIComponent(id)}`);
  return operations;
}

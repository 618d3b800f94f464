/** A session that the page carries with it, as a report does: nothing is asked of a server then. */

import type { Edge, Observed, Session } from './api';
import type { ScenePart } from './parts';

/** What a report carries, as JSON in an element of the page. */
export interface Embedded {
  session: Session;
  scene: ScenePart[];
  edges: Edge[];
  /** By keyframe: the image as a data address, and what was measured in it. */
  images: Record<string, { image: string; observed: Observed }>;
}

function read(): Embedded | null {
  const text = typeof document === 'undefined' ? null : document.getElementById('report-data')?.textContent;
  return text ? (JSON.parse(text) as Embedded) : null;
}

/** The session of this page, if it carries one. */
export const embedded = read();

/** What the server would answer to a question about that session. */
export function answerFrom(data: Embedded, path: string): Response {
  const { pathname, searchParams } = new URL(path, 'http://report');
  const rest = pathname.replace(/^\/v1\/sessions\/[^/]+/, '');
  const image = /^\/keyframes\/(\d+)\/(image|observed)$/.exec(rest);
  if (rest === '') return Response.json(data.session);
  if (rest === '/scene') return new Response(data.scene.map((part) => JSON.stringify(part)).join('\n'));
  if (rest === '/graph') return Response.json({ edges: wanted(data.edges, searchParams) });
  const kept = image && data.images[image[1]!];
  if (!kept) return Response.json({ detail: 'This is not in the report.' }, { status: 404 });
  return image[2] === 'image' ? new Response(bytesOf(kept.image)) : Response.json(kept.observed);
}

function wanted(edges: Edge[], query: URLSearchParams): Edge[] {
  const [minWeight, of] = [Number(query.get('min_weight') ?? 1), query.get('keyframe_id')];
  const touches = ({ from, to }: Edge) => of === null || from === Number(of) || to === Number(of);
  return edges.filter((edge) => edge.weight >= minWeight && touches(edge));
}

/** The bytes of a data address in base 64, with their type. */
function bytesOf(address: string): Blob {
  const [head = '', data = ''] = address.split(',', 2);
  const bytes = Uint8Array.from(atob(data), (character) => character.charCodeAt(0));
  return new Blob([bytes], { type: head.replace(/^data:/, '').replace(/;base64$/, '') });
}

import { describe, expect, it } from 'vitest';
import { answerFrom, type Embedded } from '../src/data/embedded';

const edge = (from: number, to: number, weight: number) => ({ from, to, weight, n_points: weight, n_lines: 0 });

const data = {
  session: { id: 'room', n_frames: 3 },
  scene: [{ end: { revision: '1' } }, { removed: { keyframes: [], points: [], lines: [], primitives: [] } }],
  edges: [edge(1, 2, 30), edge(2, 3, 5)],
  images: { 2: { image: `data:image/png;base64,${btoa('png')}`, observed: { width: 4 } } },
} as unknown as Embedded;

const ask = (rest: string) => answerFrom(data, `/v1/sessions/room${rest}`);

describe('a session that the page carries', () => {
  it('answers as the server does', async () => {
    expect(await ask('').json()).toEqual(data.session);
    expect((await ask('/scene').text()).split('\n').map((line) => JSON.parse(line))).toEqual(data.scene);
    expect(await ask('/keyframes/2/observed').json()).toEqual({ width: 4 });
    const image = await ask('/keyframes/2/image').blob();
    expect([image.type, await image.text()]).toEqual(['image/png', 'png']);
  });

  it('tells the wanted edges', async () => {
    const edges = async (query: string) => ((await ask(`/graph${query}`).json()) as { edges: { weight: number }[] }).edges.map(({ weight }) => weight);
    expect(await edges('?min_weight=15')).toEqual([30]);
    expect(await edges('?min_weight=1&keyframe_id=3')).toEqual([5]);
    expect(await edges('')).toEqual([30, 5]);
  });

  it('says what is not there', () => {
    expect(ask('/keyframes/1/image').status).toBe(404);
    expect(ask('/frames/1/image').status).toBe(404);
  });
});

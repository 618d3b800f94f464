import { describe, expect, test } from 'vitest';
import type { Operation } from '../src/data/api';
import { told } from '../src/panels/operations';

const operation = (change: Partial<Operation>): Operation => ({
  id: 'one',
  kind: 'optimize',
  session_id: 'room',
  from_session_id: null,
  state: 'running',
  progress: 0.256,
  message: '',
  ...change,
});

describe('an operation is told in a sentence', () => {
  test('how far it is', () => {
    expect(told(operation({}))).toBe('Optimizing the map: 26 %.');
    expect(told(operation({ state: 'queued' }))).toBe('Optimizing the map: waits for its turn.');
    expect(told(operation({ kind: 'merge', from_session_id: 'hall' }))).toBe('Joining hall: 26 %.');
  });

  test('how it ended, in the server’s words', () => {
    expect(told(operation({ state: 'done', message: 'The cost fell.' }))).toBe('The cost fell.');
    expect(told(operation({ state: 'failed', message: 'The disk is full.' }))).toBe('The disk is full.');
    expect(told(operation({ state: 'cancelled' }))).toContain('nothing was changed');
  });
});

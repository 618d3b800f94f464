import { describe, expect, test } from 'vitest';
import { formatAddress, HIDDEN_AT_FIRST, openSession, parseAddress, type SessionAddress } from '../src/address';

describe('addresses', () => {
  test('a state comes back from its address', () => {
    const state: SessionAddress = {
      page: 'session',
      id: 'kitchen_2-a',
      frame: 120,
      keyframe: 7,
      hidden: ['lines', 'keyframes'],
      eye: { position: [1.5, -2, 3e-4], target: [0, 0.25, -7] },
      follow: true,
    };
    expect(parseAddress(formatAddress(state))).toEqual(state);
    expect(parseAddress(formatAddress(openSession('s')))).toEqual(openSession('s'));
    expect(formatAddress(openSession('s'))).toBe('#/s/s');
    expect(parseAddress(formatAddress({ page: 'list' }))).toEqual({ page: 'list' });
  });

  test('nothing shown is a state of its own', () => {
    const state = { ...openSession('s'), hidden: [...parseAll()] };
    expect(parseAddress(formatAddress(state))).toEqual(state);
  });

  test('what cannot be understood is as at first', () => {
    for (const hash of ['', '#', '#/x', '#/s/', '#/s/a%2Fb', '#/s/<b>', `#/s/${'a'.repeat(65)}`]) {
      expect(parseAddress(hash)).toEqual({ page: 'list' });
    }
    const odd = parseAddress('#/s/s?frame=-1&keyframe=1e9&eye=1,2,NaN,4,5,6&follow=yes');
    expect(odd).toEqual({ ...openSession('s'), hidden: HIDDEN_AT_FIRST });
  });
});

const parseAll = () => (parseAddress('#/s/s?show=') as SessionAddress).hidden;

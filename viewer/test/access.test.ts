import { describe, expect, it } from 'vitest';
import { tokenIn } from '../src/data/access';

describe('a token in the address', () => {
  it('is taken from behind the # alone', () => {
    expect(tokenIn('#token=monoslam_aB-9_x')).toBe('monoslam_aB-9_x');
  });
  it('is not seen in other addresses', () => {
    for (const hash of ['', '#/', '#token=', '#/s/kitchen?token=x', '#token=a b', '#token=<x>']) expect(tokenIn(hash)).toBeNull();
  });
});

import { describe, expect, it } from 'vitest';
import { assumedCamera, correctedAngle, focalOfAngle } from '../src/capture/advice';
import { frameSize } from '../src/capture/camera';
import { lineOf } from '../src/capture/motion';
import { Ledger, MAX_HELD_BYTES, WINDOW, type Shot } from '../src/capture/ledger';

const shot = (bytes = 10): Shot => ({ timestampNs: 0n, image: { size: bytes } as Blob });

function opened(n: number, nextSequence = 0): Ledger {
  const ledger = new Ledger();
  ledger.opened(nextSequence);
  for (let i = 0; i < n; i += 1) ledger.add(shot());
  return ledger;
}

function sent(ledger: Ledger): number[] {
  const sequences: number[] = [];
  for (let taken = ledger.take(); taken; taken = ledger.take()) sequences.push(taken[0]);
  return sequences;
}

describe('frames of a stream', () => {
  it('are sent once and go on behind those that are there', () => {
    const ledger = opened(3, 7);
    expect(sent(ledger)).toEqual([7, 8, 9]);
    expect(sent(ledger)).toEqual([]);
  });

  it('are sent again if a killed server lost them', () => {
    const ledger = opened(5);
    sent(ledger);
    expect([0, 1, 2].map((sequence) => ledger.answered(sequence, true, 0))).toEqual([true, true, true]);
    ledger.disconnected();
    expect(ledger.hasRoom).toBe(false);
    expect(sent(ledger)).toEqual([]);
    ledger.opened(1);
    // Two at a time: the server would drop what it cannot queue.
    expect(sent(ledger)).toEqual([1, 2]);
    expect([1, 2].map((sequence) => ledger.answered(sequence, true, 1))).toEqual([false, false]);
    expect(sent(ledger)).toEqual([3, 4]);
    ledger.add(shot());
    expect(sent(ledger)).toEqual([]);
    expect([3, 4].map((sequence) => ledger.answered(sequence, true, 1))).toEqual([true, true]);
    expect(sent(ledger)).toEqual([5]);
  });

  it('are not sent again once they are dropped or saved', () => {
    const ledger = opened(3);
    sent(ledger);
    ledger.answered(0, false, null);
    ledger.answered(1, true, 1);
    expect(ledger.nHeld).toBe(1);
    ledger.disconnected();
    ledger.opened(0);
    expect(sent(ledger)).toEqual([2]);
  });

  it('wait while the window is full', () => {
    const ledger = opened(WINDOW);
    sent(ledger);
    expect(ledger.hasRoom).toBe(false);
    ledger.answered(0, true, null);
    expect(ledger.hasRoom).toBe(true);
  });

  it('take bounded memory', () => {
    const ledger = new Ledger();
    ledger.opened(0);
    for (let i = 0; i < 10; i += 1) {
      ledger.add(shot(MAX_HELD_BYTES / 4));
      sent(ledger);
      ledger.answered(i, true, null);
    }
    expect(ledger.nHeld).toBe(4);
  });
});

describe('the lens', () => {
  it('has the focal length of its angle along the longer side', () => {
    expect(focalOfAngle(640, 480, 90)).toBeCloseTo(320);
    expect(focalOfAngle(480, 640, 90)).toBeCloseTo(320);
    expect(assumedCamera(640, 480, 90)).toMatchObject({ fx: expect.closeTo(320), cx: 319.5, cy: 239.5 });
  });

  it('sees less when the focal length is longer', () => {
    const angle = correctedAngle(65, 0.1);
    expect(focalOfAngle(640, 480, angle)).toBeCloseTo(1.1 * focalOfAngle(640, 480, 65));
    expect(correctedAngle(65, 0)).toBeCloseTo(65);
  });

  it('gives frames no larger than the network takes', () => {
    expect(frameSize(640, 480)).toEqual([640, 480]);
    expect(frameSize(1080, 1920)).toEqual([540, 960]);
  });
});

it('readings of motion sensors are lines of a EuRoC recording', () => {
  const line = lineOf(123.4567, 1_700_000_000_000, [0.1, -0.25, 1 / 3], [0, -9.81, 1e-9]);
  expect(line).toBe('1700000000123457000,0.1,-0.25,0.3333333,0,-9.81,1e-9');
});

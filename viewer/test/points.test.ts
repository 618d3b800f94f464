import { expect, test } from 'vitest';
import { PointTable } from '../src/data/points';

test('points are found by their ids, whatever was added and removed around them', () => {
  const table = new PointTable();
  // More than there is room for at first.
  for (let id = 0; id < 5000; id += 1) table.set(id, id % 3, [id, -id, 0.5], id % 7 ? id % 256 : null, id + 1);
  for (let id = 0; id < 5000; id += 2) table.delete(id);
  table.delete(4); // Twice is no harm.
  table.set(9, 2, [1, 2, 3], null, 4);
  expect(table.size).toBe(2500);
  expect(table.get(8)).toBeUndefined();
  expect(table.get(9)).toEqual({ id: 9, submap: 2, position: [1, 2, 3], gray: null, createdBy: 4 });
  for (let id = 1; id < 5000; id += 2) {
    if (id === 9) continue;
    expect(table.get(id)).toEqual({ id, submap: id % 3, position: [id, -id, 0.5], gray: id % 7 ? id % 256 : null, createdBy: id + 1 });
  }
  const rows = Array.from(table.ids.subarray(0, table.size)).sort((a, b) => a - b);
  expect(rows).toEqual([...table.keys()].sort((a, b) => a - b));
  table.clear();
  expect([table.size, table.get(9)]).toEqual([0, undefined]);
});

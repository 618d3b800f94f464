/** The points of a map in columns: 34 bytes each and an entry of a map, where there would be two objects. */

export interface PointRow {
  id: number;
  submap: number;
  position: [number, number, number];
  gray: number | null;
  createdBy: number;
}

/** Rows there is room for at first; doubled when there are more. */
const FIRST_ROOM = 1024;

/** Stands for a point whose shade is not known. */
const NO_GRAY = -1;

/** See the module's documentation. Rows lie in no order, and change their places when others are removed. */
export class PointTable {
  ids = new Float64Array(FIRST_ROOM);
  submaps = new Int32Array(FIRST_ROOM);
  /** Three numbers a row. */
  positions = new Float32Array(3 * FIRST_ROOM);
  grays = new Int16Array(FIRST_ROOM);
  createdBy = new Float64Array(FIRST_ROOM);
  readonly #rows = new Map<number, number>();

  /** How many points there are: the first rows of each column. */
  get size(): number {
    return this.#rows.size;
  }

  get(id: number): PointRow | undefined {
    const row = this.#rows.get(id);
    if (row === undefined) return undefined;
    const [x, y, z] = this.positions.subarray(3 * row, 3 * row + 3) as unknown as [number, number, number];
    return { id, submap: this.submaps[row]!, position: [x, y, z], gray: this.grayAt(row), createdBy: this.createdBy[row]! };
  }

  grayAt(row: number): number | null {
    const gray = this.grays[row]!;
    return gray === NO_GRAY ? null : gray;
  }

  keys(): IterableIterator<number> {
    return this.#rows.keys();
  }

  set(id: number, submap: number, position: readonly number[], gray: number | null, createdBy: number): void {
    let row = this.#rows.get(id);
    if (row === undefined) {
      row = this.#rows.size;
      if (row === this.ids.length) this.#grow();
      this.#rows.set(id, row);
    }
    this.ids[row] = id;
    this.submaps[row] = submap;
    this.positions.set(position, 3 * row);
    this.grays[row] = gray ?? NO_GRAY;
    this.createdBy[row] = createdBy;
  }

  delete(id: number): void {
    const row = this.#rows.get(id);
    if (row === undefined) return;
    const last = this.#rows.size - 1;
    this.#rows.delete(id);
    if (row === last) return;
    this.ids[row] = this.ids[last]!;
    this.submaps[row] = this.submaps[last]!;
    this.positions.copyWithin(3 * row, 3 * last, 3 * last + 3);
    this.grays[row] = this.grays[last]!;
    this.createdBy[row] = this.createdBy[last]!;
    this.#rows.set(this.ids[row]!, row);
  }

  clear(): void {
    this.#rows.clear();
  }

  #grow(): void {
    const grown = <T extends Float64Array | Float32Array | Int32Array | Int16Array>(column: T): T => {
      const larger = new (column.constructor as new (n: number) => T)(2 * column.length);
      larger.set(column);
      return larger;
    };
    this.ids = grown(this.ids);
    this.submaps = grown(this.submaps);
    this.positions = grown(this.positions);
    this.grays = grown(this.grays);
    this.createdBy = grown(this.createdBy);
  }
}

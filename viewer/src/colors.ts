/** Colors of what is drawn. Both themes use the same hues, told apart also by people who confuse red and green. */

import type { State } from './data/api';
import type { Theme } from './theme';

/** Hues for global primitives (after Okabe and Ito), in turn by their ids. */
const PRIMITIVES: Record<Theme, string[]> = {
  dark: ['#e69f00', '#56b4e9', '#1fc08e', '#f0e442', '#7aa2ff', '#ff7a3d', '#e691c3'],
  light: ['#a86f00', '#0a76b8', '#00795a', '#8a7d00', '#2348c7', '#c04a00', '#a83d7d'],
};

/** Hues of trajectories, in turn by submap. */
const SUBMAPS: Record<Theme, string[]> = {
  dark: ['#5fb3ff', '#ff8fd2', '#8ee05a', '#c9a2ff', '#ffd166'],
  light: ['#0b62c4', '#b3127a', '#3b7a0c', '#6a35c2', '#8f6400'],
};

const STATES: Record<Theme, Record<State, string>> = {
  dark: { initialising: '#8fa3bd', tracked: '#2fbf71', weak: '#f2b134', lost: '#ff5d73' },
  light: { initialising: '#7488a3', tracked: '#1d8f52', weak: '#c98a00', lost: '#c9263f' },
};

export interface Palette {
  background: string;
  /** Points and lines without a color of their own. */
  neutral: string;
  keyframe: string;
  selected: string;
  camera: string;
  covisibility: string;
  primitiveEdge: string;
}

const PALETTES: Record<Theme, Palette> = {
  dark: {
    background: '#0b1118',
    neutral: '#8796a8',
    keyframe: '#7f93ab',
    selected: '#ffd166',
    camera: '#ffffff',
    covisibility: '#2fbf71',
    primitiveEdge: '#ff5d73',
  },
  light: {
    background: '#eef1f5',
    neutral: '#6b7785',
    keyframe: '#5b6c80',
    selected: '#b25e00',
    camera: '#000000',
    covisibility: '#12834a',
    primitiveEdge: '#d0233f',
  },
};

const inTurn = (colors: string[], number: number) => colors[Math.abs(number) % colors.length]!;

export const palette = (theme: Theme): Palette => PALETTES[theme];
export const stateColor = (state: State, theme: Theme): string => STATES[theme][state];
export const submapColor = (submap: number, theme: Theme): string => inTurn(SUBMAPS[theme], submap);
export const primitiveColor = (id: number | null, theme: Theme): string =>
  id === null ? PALETTES[theme].neutral : inTurn(PRIMITIVES[theme], id);

/**
 * The share of white, 0 to 1, in which a point of a gray value is drawn: monotonic in the gray, and away from the
 * background, so that neither black nor white points vanish.
 */
export function shade(gray: number | null, theme: Theme): number {
  if (gray === null) return theme === 'dark' ? 0.6 : 0.42;
  return theme === 'dark' ? 0.28 + (0.72 * gray) / 255 : (0.62 * gray) / 255;
}

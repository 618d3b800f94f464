/** Files to take away, and the address of what is shown. */

import { sessionPath } from '../data/api';
import { announce, h } from '../dom';

export function exportsPanel(id: string, takePicture: () => string | undefined): HTMLElement {
  const path = sessionPath(id);
  const file = (text: string, query: string, name: string) => h('a', { href: `${path}/${query}`, download: `${id}${name}` }, text);
  const copied = h('span', { class: 'note', role: 'status' });
  const copy = async () => {
    try {
      await navigator.clipboard.writeText(location.href);
      copied.textContent = 'Copied.';
    } catch {
      copied.textContent = 'Copy it from the address bar: it says all that is shown.';
    }
  };
  const picture = () => {
    const url = takePicture();
    if (!url) return;
    h('a', { href: url, download: `${id}.png` }).click();
    announce('The picture was saved.');
  };
  return h(
    'section',
    { class: 'panel', 'aria-label': 'Export' },
    h('h2', {}, 'Export'),
    h('p', { class: 'links' }, 'Map: ', file('PLY', 'map?format=ply', '.ply'), file('JSON', 'map?format=json', '.json'), file('cameras.txt', 'map?format=colmap&part=cameras', '_cameras.txt'), file('images.txt', 'map?format=colmap&part=images', '_images.txt'), file('points3D.txt', 'map?format=colmap&part=points3D', '_points3D.txt')),
    h('p', { class: 'links' }, 'Trajectory: ', file('TUM', 'trajectory?format=tum', '.txt'), file('EuRoC', 'trajectory?format=euroc', '_euroc.csv'), file('KITTI', 'trajectory?format=kitti', '_kitti.txt'), file('CSV', 'trajectory?format=csv', '.csv'), file('JSON', 'trajectory?format=json', '_trajectory.json')),
    h('div', { class: 'row' }, h('button', { type: 'button', onclick: picture }, 'Save picture'), h('button', { type: 'button', onclick: () => void copy() }, 'Copy link'), copied),
  );
}

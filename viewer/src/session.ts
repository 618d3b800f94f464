/** The page of one session: the map, the current image, figures and the timeline, kept together. */

import { formatAddress, type SessionAddress } from './address';
import { ApiProblem, getEdges, getSession, sessionPath, type Session } from './data/api';
import { embedded } from './data/embedded';
import { Follower, type FrameEvent } from './data/live';
import { Scene } from './data/scene';
import { announce, h } from './dom';
import { moveByKey, pickKeyframe, pickPoint, type ScreenPlace } from './map/picking';
import { MapView } from './map/view';
import { exportsPanel } from './panels/exports';
import { ImagePanel } from './panels/image';
import { KeyframePanel } from './panels/keyframe';
import { Layers } from './panels/layers';
import { MeasurePanel } from './panels/measure';
import { OperationsPanel } from './panels/operations';
import { Statistics } from './panels/statistics';
import { Timeline } from './panels/timeline';

/** Landmarks two keyframes must share for their edge to be drawn. */
const MIN_EDGE_WEIGHT = 15;
/** Time between two readings of the edges of a map that grows, ms. */
const EDGES_INTERVAL_MS = 5000;
/** A press that moves farther than this, pixels, turns the map and selects nothing. */
const CLICK_SLACK_PX = 6;

export class SessionPage {
  readonly #scene = new Scene();
  readonly #trouble = h('p', { class: 'banner', role: 'alert', hidden: true });
  readonly #waiting = h('p', { class: 'waiting' }, 'Loading the map…');
  readonly #stage = h('div', { class: 'stage' });
  readonly #image = new ImagePanel();
  readonly #statistics = new Statistics();
  readonly #layers: Layers;
  readonly #timeline: Timeline;
  readonly #keyframe: KeyframePanel;
  readonly #measure: MeasurePanel;
  readonly #operations: OperationsPanel | null;
  readonly #follower: Follower;
  readonly #follow = h('input', { type: 'checkbox', id: 'follow' });
  readonly #onTheme = () => this.#sceneChanged();
  #view: MapView | null = null;
  #session: Session | null = null;
  #liveFrame: FrameEvent | null = null;
  #edges: [number, number][] = [];
  #edgesRead = -Infinity;
  #edgesRevision: string | null = null;
  #drawing = 0;
  #takeScene = true;

  constructor(
    private readonly root: HTMLElement,
    private readonly address: SessionAddress,
  ) {
    const { id } = address;
    this.#layers = new Layers((hidden) => this.#change({ hidden }));
    this.#timeline = new Timeline(this.#scene, (frame) => this.#change({ frame }));
    this.#keyframe = new KeyframePanel(id, this.#scene, (keyframe) => this.#change({ keyframe }));
    const onSession = (session: Session) => this.#takeSession(session);
    this.#measure = new MeasurePanel(id, this.#scene, () => this.#draw(), onSession);
    this.#operations = embedded ? null : new OperationsPanel(id, () => this.#readSession());
    this.#follow.addEventListener('change', () => this.#change({ follow: this.#follow.checked }));
    this.#buildStage();
    // What is asked of a server is not in a report.
    const exports = () => exportsPanel(id, () => this.#view?.picture());
    const asked = this.#operations ? [this.#measure.element, this.#operations.element, exports()] : [];
    const side = h('div', { class: 'side' }, this.#image.element, this.#statistics.element, this.#keyframe.element, ...asked);
    const left = h('div', { class: 'left' }, this.#stage, this.#timeline.element);
    root.replaceChildren(h('h1', { class: 'visually-hidden' }, `Session ${id}`), this.#trouble, h('div', { class: 'session' }, left, side));
    this.#follower = new Follower(id, this.#scene, {
      session: onSession,
      frame: (event) => this.#takeFrame(event),
      changed: (complete) => this.#sceneChanged(complete),
      trouble: (sentence) => this.#say(sentence),
      gone: () => this.#gone(),
    });
    window.addEventListener('themechange', this.#onTheme);
    this.update(address);
  }

  /** Shows another state of the same session, as after going back. */
  update(address: SessionAddress): void {
    Object.assign(this.address, address);
    this.#follow.checked = address.follow;
    if (address.eye) this.#view?.setEye(address.eye);
    this.#draw();
  }

  close(): void {
    window.removeEventListener('themechange', this.#onTheme);
    this.#follower.close();
    this.#timeline.close();
    this.#operations?.close();
    this.#image.close();
    this.#view?.dispose();
    cancelAnimationFrame(this.#drawing);
  }

  #buildStage(): void {
    try {
      this.#view = new MapView(this.#scene);
    } catch {
      this.#stage.replaceChildren(h('p', { class: 'waiting' }, 'This browser cannot draw in three dimensions (WebGL). Images, figures and exports work all the same.'));
      return;
    }
    const view = this.#view;
    const { canvas } = view;
    canvas.tabIndex = 0;
    canvas.setAttribute('role', 'application');
    canvas.setAttribute('aria-label', 'Map in three dimensions. Arrow keys turn it, with shift they move it; plus and minus zoom, Home shows all.');
    view.onEye = (eye) => this.#change({ eye }, true);
    canvas.addEventListener('keydown', (event) => {
      if (event.key === 'Enter' && this.#measure.picking) {
        this.#pick({ x: canvas.clientWidth / 2, y: canvas.clientHeight / 2, pointer: 'touch' });
      } else if (!event.ctrlKey && !event.metaKey && moveByKey(view, event)) {
        event.preventDefault();
      }
    });
    let down = { x: 0, y: 0 };
    canvas.addEventListener('pointerdown', (event) => (down = { x: event.offsetX, y: event.offsetY }));
    canvas.addEventListener('pointerup', (event) => {
      if (Math.hypot(event.offsetX - down.x, event.offsetY - down.y) > CLICK_SLACK_PX) return;
      this.#pick({ x: event.offsetX, y: event.offsetY, pointer: event.pointerType });
    });
    const all = h('button', { type: 'button', onclick: () => this.#showAll() }, 'Show all');
    const follow = h('label', { for: 'follow' }, this.#follow, ' Follow the camera');
    const tools = h('div', { class: 'tools' }, all, follow);
    const cross = h('span', { class: 'cross', 'aria-hidden': 'true' });
    this.#stage.replaceChildren(canvas, cross, this.#waiting, tools, this.#layers.element);
    if (this.address.eye) view.setEye(this.address.eye);
  }

  #showAll(): void {
    this.#view?.frameAll();
    this.#change({ eye: null });
  }

  #pick(at: ScreenPlace): void {
    if (!this.#view) return;
    if (!this.#measure.picking) {
      if (this.address.hidden.includes('keyframes')) return;
      const keyframe = pickKeyframe(this.#view, this.#scene, at);
      if (keyframe !== null) this.#change({ keyframe });
      return;
    }
    const found = pickPoint(this.#view, at);
    const row = found && this.#scene.points.get(found.id);
    if (!row) {
      announce('There is no point here.');
      return;
    }
    this.#measure.pick({ id: row.id, submap: row.submap, position: row.position });
  }

  /** Changes what is shown, and the address with it; `quietly` if it is on the screen already. */
  #change(change: Partial<SessionAddress>, quietly = false): void {
    Object.assign(this.address, change);
    if ('keyframe' in change) announce(change.keyframe == null ? 'No keyframe selected.' : `Keyframe ${change.keyframe} selected.`);
    history.replaceState(null, '', formatAddress(this.address));
    if (!quietly) this.#draw();
  }

  #takeSession(session: Session): void {
    this.#session = session;
    this.#measure.update();
    this.#operations?.update(session);
    this.#draw();
  }

  #readSession(): void {
    getSession(this.address.id).then((session) => this.#takeSession(session), (error: unknown) => {
      if (error instanceof ApiProblem && error.status === 404) this.#gone();
    });
  }

  #takeFrame(event: FrameEvent): void {
    this.#liveFrame = event;
    this.#statistics.frame(event);
    if (this.#session) Object.assign(this.#session, { state: event.state, has_writer: true });
    this.#draw();
  }

  #sceneChanged(complete = true): void {
    this.#takeScene = true;
    if (complete) {
      const empty = this.#scene.keyframes.size === 0;
      this.#waiting.textContent = empty ? 'There is no map yet: it begins once the camera has moved sideways.' : '';
      this.#waiting.hidden = !empty;
      if (this.#scene.revision !== null) this.#keyframe.update(this.address.keyframe, true);
      this.#readSession();
    }
    void this.#readEdges();
    this.#image.redraw();
    this.#draw();
  }

  async #readEdges(): Promise<void> {
    const { hidden, id } = this.address;
    const unwanted = hidden.includes('covisibility') && hidden.includes('primitives');
    const now = performance.now();
    const { revision } = this.#scene;
    if (unwanted || revision === null || revision === this.#edgesRevision || now - this.#edgesRead < EDGES_INTERVAL_MS) return;
    this.#edgesRead = now;
    try {
      this.#edges = (await getEdges(id, MIN_EDGE_WEIGHT)).map(({ from, to }) => [from, to]);
      this.#edgesRevision = revision;
      this.#draw();
    } catch {
      // The next reading of the scene asks again.
    }
  }

  #say(sentence: string | null): void {
    this.#trouble.hidden = sentence === null;
    this.#trouble.textContent = sentence;
  }

  #gone(): void {
    this.close();
    this.root.replaceChildren(h('section', { class: 'empty' }, h('h1', {}, `Session ${this.address.id}`), h('p', {}, 'There is no such session, or no longer.'), h('p', {}, h('a', { href: '#/' }, 'All sessions'))));
  }

  /** Draws everything once before the next refresh of the screen. */
  #draw(): void {
    if (this.#drawing) return;
    this.#drawing = requestAnimationFrame(() => {
      this.#drawing = 0;
      this.#drawNow();
    });
  }

  #drawNow(): void {
    const { address } = this;
    if (this.#takeScene) {
      this.#takeScene = false;
      this.#view?.takeScene();
    }
    void this.#readEdges();
    this.#stage.classList.toggle('picking', this.#measure.picking);
    this.#view?.show({
      lastFrame: address.frame ?? Infinity,
      selected: address.keyframe,
      hidden: address.hidden,
      covisibility: this.#edges,
      marks: this.#measure.picked.map(({ submap, position }) => {
        const offset = this.#view!.offsetOf(submap);
        return [position[0] + offset[0], position[1] + offset[1], position[2] + offset[2]];
      }),
      follow: address.follow,
    });
    this.#timeline.update(address.frame);
    this.#layers.update(address.hidden, this.#scene, this.#view?.primitiveEdges ?? { drawn: 0, total: 0 });
    if (this.#session) this.#statistics.update(this.#session, this.#scene);
    this.#keyframe.update(address.keyframe, false);
    this.#showImage();
  }

  /** The selected keyframe's image, else the newest frame's while they come in, else the last keyframe's. */
  #showImage(): void {
    const { address } = this;
    const base = sessionPath(address.id);
    const selected = address.keyframe === null ? undefined : this.#scene.keyframes.get(address.keyframe);
    if (selected?.hasImage) {
      this.#image.show({ path: `${base}/keyframes/${selected.id}`, title: `Keyframe ${selected.id}` });
    } else if (address.frame === null && this.#liveFrame && this.#session?.has_writer) {
      const { sequence } = this.#liveFrame;
      this.#image.show({ path: `${base}/frames/${sequence}`, title: `Frame ${sequence}` });
    } else {
      const row = this.#scene.keyframeAt(address.frame ?? Infinity, true);
      this.#image.show(row && { path: `${base}/keyframes/${row.id}`, title: `Keyframe ${row.id}, frame ${row.sequence}` });
    }
  }
}

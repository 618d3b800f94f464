/** Light or dark: what the system says until the reader chooses. */

export type Theme = 'light' | 'dark';

const KEY = 'monoslam-theme';

function stored(): Theme | null {
  try {
    const value = localStorage.getItem(KEY);
    return value === 'light' || value === 'dark' ? value : null;
  } catch {
    return null;
  }
}

/** The theme in use. */
export function theme(): Theme {
  return stored() ?? (matchMedia('(prefers-color-scheme: dark)').matches ? 'dark' : 'light');
}

/** Sets the page's theme, wires the button, and tells `onChange` whenever the colors change. */
export function setUpTheme(button: HTMLButtonElement): void {
  const apply = () => {
    const now = theme();
    document.documentElement.dataset.theme = now;
    button.textContent = now === 'dark' ? 'Light' : 'Dark';
    button.setAttribute('aria-label', now === 'dark' ? 'Use light colors' : 'Use dark colors');
    window.dispatchEvent(new CustomEvent('themechange'));
  };
  button.addEventListener('click', () => {
    try {
      localStorage.setItem(KEY, theme() === 'dark' ? 'light' : 'dark');
    } catch {
      // Without storage the system's choice stays.
    }
    apply();
  });
  matchMedia('(prefers-color-scheme: dark)').addEventListener('change', apply);
  apply();
}

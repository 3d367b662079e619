//! Keys of the terminal, by what they do.

use ferrocnc::tryout::{Edge, Key, Way};
use ratatui::crossterm::event::{KeyCode, KeyEvent, KeyEventKind, KeyModifiers};

/// What a key does; while a number is typed, digits and signs are its.
pub(super) fn key(event: &KeyEvent, typing: bool) -> Option<Key> {
    let way = match event.code {
        KeyCode::Left => Some(Way::Minus),
        KeyCode::Right => Some(Way::Plus),
        _ => None,
    };
    if let Some(way) = way {
        let edge = match event.kind {
            KeyEventKind::Press | KeyEventKind::Repeat => Edge::Down,
            KeyEventKind::Release => Edge::Up,
        };
        return Some(Key::Move(way, edge));
    }
    if event.kind == KeyEventKind::Release {
        return None;
    }
    let key = match event.code {
        KeyCode::Char('c') if event.modifiers.contains(KeyModifiers::CONTROL) => Key::Escape,
        KeyCode::Char(digit @ ('0'..='9' | '.')) => Key::Digit(digit),
        KeyCode::Char('-') if typing => Key::Digit('-'),
        KeyCode::Backspace => Key::Backspace,
        KeyCode::Enter => Key::Enter,
        KeyCode::Esc | KeyCode::Char('q') => Key::Escape,
        KeyCode::Up => Key::Previous,
        KeyCode::Down => Key::Next,
        KeyCode::Char('a') => Key::Arm,
        KeyCode::Char(' ') => Key::Stop,
        KeyCode::Char('z') => Key::Mark,
        KeyCode::Char('-') => Key::Slower,
        KeyCode::Char('+') => Key::Faster,
        KeyCode::Char('d') => Key::Distance,
        KeyCode::Char('m') => Key::Measure,
        KeyCode::Char('w') => Key::Write,
        _ => return None,
    };
    Some(key)
}

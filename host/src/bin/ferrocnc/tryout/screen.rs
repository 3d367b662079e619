//! The drawing: inputs on the left, what can be driven on the right, what was said below.

use ferrocnc::tryout::measured::number;
use ferrocnc::tryout::{Arming, Labelled, Row, Tryout};
use ratatui::Frame;
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::style::{Color, Modifier, Style};
use ratatui::text;
use ratatui::widgets::{Block, Paragraph};

const HELP: [&str; 2] = [
    "a arm/off   space stop   up/down select   Enter output   hold left/right: jog",
    "d distance   - + speed   z count from here   m measured   w write   q quit",
];

/// Name and pins, in columns.
fn named(line: &Labelled) -> String {
    format!("{:<16} {:<12}", line.name, line.pins)
}

pub(super) fn draw(frame: &mut Frame<'_>, tryout: &Tryout, title: &str) {
    let [head, body, foot] = Layout::vertical([
        Constraint::Length(1),
        Constraint::Min(3),
        Constraint::Length(5),
    ])
    .areas(frame.area());
    let colour = match (tryout.status(), tryout.arming()) {
        (None, _) | (Some(_), Arming::Armed) => Color::Red,
        (Some(_), Arming::Asked { .. }) => Color::Yellow,
        (Some(_), Arming::Off) => Color::Green,
    };
    let state = text::Span::styled(
        tryout.state(),
        Style::new().fg(colour).add_modifier(Modifier::BOLD),
    );
    let head_line = text::Line::from(vec![format!("{title}   ").into(), state]);
    frame.render_widget(Paragraph::new(head_line), head);
    let [left, right] =
        Layout::horizontal([Constraint::Length(40), Constraint::Min(40)]).areas(body);
    frame.render_widget(inputs(tryout), left);
    rows(frame, right, tryout);
    let said = match tryout.typed() {
        Some(typed) => format!("measured: {typed}_   (Enter takes it, Escape leaves)"),
        None => tryout.said().to_owned(),
    };
    let lines = [said, String::new(), HELP[0].to_owned(), HELP[1].to_owned()];
    frame.render_widget(Paragraph::new(lines.join("\n")), foot);
}

fn inputs(tryout: &Tryout) -> Paragraph<'static> {
    let levels = tryout.status().map(|status| status.gpio_in);
    let line = |input: &Labelled| {
        let level = levels.map(|levels| levels >> input.bit & 1 != 0);
        let (text, colour) = match level {
            Some(true) => ("high", Color::Yellow),
            Some(false) => ("low", Color::Gray),
            None => ("?", Color::Red),
        };
        let level = text::Span::styled(text, Style::new().fg(colour));
        text::Line::from(vec![format!("{} ", named(input)).into(), level])
    };
    let lines: Vec<_> = tryout.layout.inputs.iter().map(line).collect();
    Paragraph::new(lines).block(Block::bordered().title("inputs"))
}

fn rows(frame: &mut Frame<'_>, area: Rect, tryout: &Tryout) {
    let layout = &tryout.layout;
    let mut lines = Vec::new();
    let mut selected = 0;
    let mut add = |row: Row, text: String| {
        let style = match tryout.row() == Some(row) {
            true => {
                selected = lines.len();
                Style::new().add_modifier(Modifier::REVERSED)
            }
            false => Style::new(),
        };
        lines.push(text::Line::styled(text, style));
    };
    for (n, output) in layout.outputs.iter().enumerate() {
        let on = match (tryout.on() == Some(n), layout.drive_enable == Some(n)) {
            (true, _) => "ON",
            (false, true) => "on while armed",
            (false, false) => "off",
        };
        add(Row::Output(n), format!("{} {on}", named(output)));
    }
    for (n, motor) in layout.motors.iter().enumerate() {
        let steps = motor.steps();
        let text = format!(
            "{} {:>10} {unit}   jog {} {unit} at {}/s",
            named(&motor.line),
            number((tryout.gone(n) as f64 / steps * 1e3).round() / 1e3),
            number(tryout.distance(motor)),
            number((tryout.speed(motor) / steps.abs() * 1e2).round() / 1e2),
            unit = match motor.scale {
                Some(_) => &layout.unit,
                None => "steps",
            },
        );
        add(Row::Motor(n), text);
    }
    for (n, encoder) in layout.encoders.iter().enumerate() {
        add(
            Row::Encoder(n),
            format!("{} {:>10} counts", named(encoder), tryout.turned(n)),
        );
    }
    let room = usize::from(area.height.saturating_sub(2));
    let first = selected.saturating_sub(room.saturating_sub(1));
    let list = Paragraph::new(lines)
        .scroll((first as u16, 0))
        .block(Block::bordered().title("outputs, motors, encoders"));
    frame.render_widget(list, area);
}

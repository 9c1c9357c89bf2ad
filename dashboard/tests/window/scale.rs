//! Large letters, a screen reader, a keyboard: what is there for those who do not use a mouse or a
//! wide screen.

use crate::{
    fixture::{at_ms, fleet, node, tell},
    screen::{Window, picture, show, show_at},
};
use dashboard::{app::Dashboard, message::Message, panels::node::Page, view::Tab};
use egui::{
    Key, Modifiers, Theme,
    accesskit::{Action, Role},
};
use egui_kittest::kittest::NodeT as _;
use std::collections::BTreeSet;

/// Pixels of a small screen.
const PIXELS: [f32; 2] = [1_440.0, 860.0];

/// Every panel, one after the other.
fn everything() -> impl Iterator<Item = (String, Dashboard)> {
    let tabs = Tab::ALL.map(|tab| (tab.title().to_owned(), tab, None));
    let pages = Page::ALL.map(|page| (format!("page {}", page.title()), Tab::Jobs, Some(page)));
    tabs.into_iter().chain(pages).map(|(name, tab, page)| {
        let mut dashboard = fleet();
        dashboard.view.tab = tab;
        if let Some(page) = page {
            dashboard.view.focus = Some(node("cell-a-1"));
            dashboard.view.node.page = page;
            let setup = Box::new(crate::node_setup::setup());
            let node = node("cell-a-1");
            tell(&mut dashboard, at_ms(1_000), Message::Setup { node, setup });
        }
        (name, dashboard)
    })
}

/// Returns role, name and place of all that can be clicked. The edges of panels and columns are left
/// out, which are dragged and give no role, and scroll bars, which follow the focus.
fn clickable(window: &Window) -> Vec<(Role, String, egui::Rect)> {
    let all = window.root().children_recursive();
    let clickable = all.filter(|node| {
        let node = node.accesskit_node();
        let role = node.role();
        let helps = matches!(role, Role::Unknown | Role::ScrollBar);
        node.data().supports_action(Action::Click) && !node.is_disabled() && !helps
    });
    clickable
        .map(|node| {
            let name = node.accesskit_node().label().unwrap_or_default();
            (node.accesskit_node().role(), name, node.rect())
        })
        .collect()
}

#[test]
fn all_that_can_be_clicked_has_a_name() {
    for (panel, dashboard) in everything() {
        let window = show(dashboard);
        window.check_accessibility();
        for (role, name, _) in clickable(&window) {
            assert!(
                !name.trim().is_empty(),
                "{panel}: a {role:?} without a name"
            );
        }
    }
}

/// Titles of the tables' columns, which are scrolled when there is no room for all of them.
const TITLES: [&str; 8] = [
    "State",
    "Job",
    "Queue",
    "Position (steps)",
    "Speed (steps/s)",
    "For",
    "Outcome",
    "What",
];

/// Returns the texts that are cut off at their left or right and not by dots that say so.
fn cut_off(window: &Window) -> Vec<String> {
    let texts: Vec<_> = window
        .output()
        .shapes
        .iter()
        .filter_map(|shape| match &shape.shape {
            egui::Shape::Text(text) if !text.galley.text().is_empty() => {
                Some((text, shape.clip_rect))
            }
            _ => None,
        })
        .collect();
    let titles = texts
        .iter()
        .filter(|(text, _)| TITLES.contains(&text.galley.text()));
    let tables: Vec<(f32, f32)> = titles
        .map(|(text, clip)| (clip.right(), text.pos.y))
        .collect();
    let in_table = |at: egui::Rect, clip: egui::Rect| {
        let below =
            |(right, top): &(f32, f32)| (right - clip.right()).abs() < 1.0 && at.top() > top - 4.0;
        tables.iter().any(below)
    };
    let mut cut = Vec::new();
    for (text, clip) in &texts {
        let at = text.visual_bounding_rect();
        let in_sight = at.intersect(*clip).is_positive();
        let inside = at.left() > clip.left() - 1.5 && at.right() < clip.right() + 1.5;
        if in_sight && !inside && !in_table(at, *clip) {
            cut.push(text.galley.text().to_owned());
        }
    }
    cut
}

#[test]
fn nothing_is_cut_off_on_a_small_screen_with_large_letters() {
    for scale in [1.25, 1.5, 2.0] {
        for (panel, dashboard) in everything() {
            let size = PIXELS.map(|pixels| pixels / scale);
            let window = show_at(dashboard, Theme::Dark, size, scale);
            assert_eq!(cut_off(&window), [""; 0], "{panel} at {scale}");
            // What is below is reached by scrolling; nothing is beside the screen.
            let beside = |at: egui::Rect| at.left() < 0.0 || at.right() > size[0];
            for (role, name, at) in clickable(&window) {
                assert!(!beside(at), "{panel} at {scale}: {role:?} {name} at {at}");
            }
        }
    }
}

#[test]
fn no_window_covers_stop_all() {
    use dashboard::{panels::chooser::Purpose, request::Scope};
    let opened: [fn(&mut Dashboard); 3] = [
        |dashboard| dashboard.view.help_open = true,
        |dashboard| dashboard.view.stop.releasing = Some(Scope::All),
        |dashboard| dashboard.view.chooser.open(Purpose::Job, ""),
    ];
    for scale in [1.0, 1.25, 1.5, 2.0] {
        for open in opened {
            let mut dashboard = fleet();
            open(&mut dashboard);
            let size = PIXELS.map(|pixels| pixels / scale);
            let window = show_at(dashboard, Theme::Dark, size, scale);
            let all = || window.root().children_recursive();
            let role =
                |role| move |node: &egui_kittest::Node<'_>| node.accesskit_node().role() == role;
            let windows: Vec<egui::Rect> = all()
                .filter(role(Role::Window))
                .map(|it| it.rect())
                .collect();
            let small: Vec<_> = windows
                .iter()
                .filter(|at| at.width() < size[0] - 1.0)
                .collect();
            assert_eq!(small.len(), 1, "{windows:?}");
            let stop = all()
                .find(|node| node.accesskit_node().label().as_deref() == Some("STOP ALL"))
                .expect("always there");
            assert!(
                !small[0].intersects(stop.rect()),
                "at {scale}: {:?}",
                small[0]
            );
        }
    }
}

#[test]
fn the_keyboard_alone_comes_to_all_that_can_be_clicked() {
    // The pages of a node differ in their plots alone.
    for (panel, mut dashboard) in everything().take(Tab::ALL.len() + 2) {
        // The rows of the fleet are the same for every panel.
        dashboard.view.fleet.filter = "cell-a-1".to_owned();
        dashboard.view.fleet.saved.clear();
        let mut window = show(dashboard);
        let mut reached = BTreeSet::new();
        loop {
            window.key_press_modifiers(Modifiers::NONE, Key::Tab);
            window.run_steps(1);
            let mut all = window.root().children_recursive();
            let focused = all.find(|node| node.accesskit_node().is_focused());
            let Some(focused) = focused else { continue };
            let focused = focused.accesskit_node();
            // Round once.
            if !reached.insert((focused.id(), focused.label().unwrap_or_default())) {
                break;
            }
        }
        for (role, name, _) in clickable(&window) {
            let known = reached.iter().any(|(_, reached)| *reached == name);
            assert!(known, "{panel}: no way to {role:?} {name}");
        }
    }
}

fn picture_at(name: &str, scale: f32) {
    picture(name, |theme| {
        show_at(fleet(), theme, PIXELS.map(|pixels| pixels / scale), scale)
    });
}

#[test]
fn picture_at_150_percent() {
    picture_at("scale_150", 1.5);
}

#[test]
fn picture_at_200_percent() {
    picture_at("scale_200", 2.0);
}

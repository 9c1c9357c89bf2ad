//! What the operator looks at and types: everything on the screen that the fleet does not know.
//!
//! One field for each panel, declared in the panel's own file. It is kept between runs, except for
//! what is marked `#[serde(skip)]`.

use crate::panels::{
    alarms::AlarmsView, chooser::ChooserView, composer::ComposerView, fleet::FleetView,
    group_job::GroupJobView, jobs::JobsView, log::LogView, node::NodeView, pulses::PulsesView,
    recording::RecordingView, stop::StopView, timeline::TimelineView,
};
use keys::NodeId;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;

/// The panels that share the lower part of the window.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Tab {
    /// Job records.
    #[default]
    Jobs,
    /// Writing and sending a job.
    Compose,
    /// Writing and sending a synchronized job.
    GroupJob,
    /// What needed somebody.
    Alarms,
    /// What the nodes did over time.
    Timeline,
    /// Lines of text.
    Log,
    /// Recorded pins.
    Pulses,
    /// Recording the session and showing it again.
    Recording,
}

impl Tab {
    /// Every tab, as shown.
    pub const ALL: [Self; 8] = [
        Self::Jobs,
        Self::Compose,
        Self::GroupJob,
        Self::Alarms,
        Self::Timeline,
        Self::Log,
        Self::Pulses,
        Self::Recording,
    ];

    /// Returns its title.
    pub const fn title(self) -> &'static str {
        match self {
            Self::Jobs => "Jobs",
            Self::Compose => "Compose",
            Self::GroupJob => "Group job",
            Self::Alarms => "Alarms",
            Self::Timeline => "Timeline",
            Self::Log => "Log",
            Self::Pulses => "Pulses",
            Self::Recording => "Recording",
        }
    }
}

/// See the module.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct View {
    /// The nodes that a stop, a release or a job of the selection is for.
    #[serde(skip)]
    pub selection: BTreeSet<NodeId>,
    /// The node whose page is open.
    pub focus: Option<NodeId>,
    /// What the lower part shows.
    pub tab: Tab,
    /// Whether the keys are shown.
    #[serde(skip)]
    pub help_open: bool,
    /// The stop and its effect.
    pub stop: StopView,
    /// The table of nodes.
    pub fleet: FleetView,
    /// The page of a node.
    pub node: NodeView,
    /// The pulse inspector.
    pub pulses: PulsesView,
    /// Recording and replay.
    pub recording: RecordingView,
    /// The choice of a file.
    #[serde(skip)]
    pub chooser: ChooserView,
    /// The list of jobs.
    pub jobs: JobsView,
    /// The composer.
    pub composer: ComposerView,
    /// The editor of synchronized jobs.
    pub group_job: GroupJobView,
    /// The list of alarms.
    pub alarms: AlarmsView,
    /// The lanes of the nodes.
    pub timeline: TimelineView,
    /// The log.
    pub log: LogView,
}

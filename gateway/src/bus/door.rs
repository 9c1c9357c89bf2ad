//! The keys that the gateway hears and answers, and the names in them.

use crate::fleet::kept::Kind;
use keys::{Keys, NodeTopic, Topic};

/// A kind of key that the gateway hears or answers, for every name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Door {
    /// `PREFIX/node/*/TOPIC`
    Node(NodeTopic),
    /// `PREFIX/group/*/job`
    GroupJob,
    /// `PREFIX/job/*`
    Job,
    /// `PREFIX/job/*/cancel`
    JobCancel,
    /// `PREFIX/manage/label/*/job`
    LabelJob,
    /// `PREFIX/manage/node/*`
    ManageNode,
    /// `PREFIX/manage/job/*`
    ManageJob,
    /// `PREFIX/manage/link/*`
    Links,
    /// `PREFIX/manage/template/*` and `…/schedule/*`
    Keep(Kind),
}

impl Door {
    /// Returns the key to declare.
    pub(super) fn key(self, keys: &Keys) -> String {
        let key = match self {
            Self::Node(topic) => keys.every_node(topic),
            Self::GroupJob => keys.every_group_job(),
            Self::Job => keys.every_job(),
            Self::JobCancel => keys.every_job_cancel(),
            Self::LabelJob | Self::ManageNode | Self::ManageJob | Self::Links | Self::Keep(_) => {
                let (before, behind) = self.around_name();
                return format!("{}{before}*{behind}", keys.prefix());
            }
        };
        key.as_str().to_owned()
    }

    /// Returns what stands around the name in keys of management.
    fn around_name(self) -> (&'static str, &'static str) {
        match self {
            Self::LabelJob => ("/manage/label/", "/job"),
            Self::ManageNode => ("/manage/node/", ""),
            Self::Links => ("/manage/link/", ""),
            Self::Keep(Kind::Template) => ("/manage/template/", ""),
            Self::Keep(Kind::Schedule) => ("/manage/schedule/", ""),
            _ => ("/manage/job/", ""),
        }
    }

    /// Returns the name chunk of a key of this kind; `None`: it only includes such keys.
    pub(super) fn name<'k>(self, keys: &Keys, key: &'k str) -> Option<&'k str> {
        if matches!(
            self,
            Self::LabelJob | Self::ManageNode | Self::ManageJob | Self::Links | Self::Keep(_)
        ) {
            let (before, behind) = self.around_name();
            let name = key.strip_prefix(keys.prefix())?.strip_prefix(before)?;
            let name = name.strip_suffix(behind)?;
            return (!name.contains('/') && name != "**").then_some(name);
        }
        let name = match (self, keys.parse(key)?) {
            (Self::Node(declared), Topic::Node { node, topic }) if topic == declared => node,
            (Self::GroupJob, Topic::GroupJob { group }) => group,
            (Self::Job, Topic::Job { job }) | (Self::JobCancel, Topic::JobCancel { job }) => job,
            _ => return None,
        };
        (name != "**").then_some(name)
    }
}

/// Returns whom a stop means. A key that includes stop keys without being one (`fleet/**`) means
/// all nodes, or those of its name chunk, also when the prefix is wild (`plant/*/node/left/stop`): what
/// nodes hear, the gateway must not miss.
pub(super) fn stop_pattern(keys: &Keys, key: &str) -> String {
    let name = key
        .strip_prefix(keys.prefix())
        .and_then(|rest| rest.strip_prefix("/node/"))
        .and_then(|rest| rest.split('/').next());
    let of_any_prefix = || {
        let (_, name) = key.strip_suffix("/stop")?.rsplit_once("/node/")?;
        (!name.contains('/')).then_some(name)
    };
    match name.or_else(of_any_prefix) {
        Some(name) if !name.contains("**") => name.to_owned(),
        _ => "*".to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stop_on_a_wide_key_means_whom_the_key_includes() {
        let keys = Keys::default();
        assert_eq!(stop_pattern(&keys, "fleet/node/left/stop"), "left");
        assert_eq!(stop_pattern(&keys, "fleet/node/cell-$*/stop"), "cell-$*");
        assert_eq!(stop_pattern(&keys, "fleet/node/left/**"), "left");
        assert_eq!(stop_pattern(&keys, "fleet/node/**"), "*");
        assert_eq!(stop_pattern(&keys, "**/stop"), "*");
        let keys = Keys::new("plant/line-a").expect("legal");
        assert_eq!(stop_pattern(&keys, "plant/*/node/*/stop"), "*");
        assert_eq!(stop_pattern(&keys, "plant/*/node/left/stop"), "left");
        assert_eq!(stop_pattern(&keys, "plant/**/node/l$*/stop"), "l$*");
        assert_eq!(stop_pattern(&keys, "plant/*/node/**/stop"), "*");
    }

    #[test]
    fn only_a_key_of_its_own_kind_gives_a_door_a_name() {
        let keys = Keys::default();
        let job = Door::Node(NodeTopic::Job);
        assert_eq!(job.name(&keys, "fleet/node/left/job"), Some("left"));
        assert_eq!(job.name(&keys, "fleet/node/cell-$*/job"), Some("cell-$*"));
        for wide in [
            "fleet/**",
            "fleet/node/**",
            "fleet/node/**/job",
            "fleet/node/left/*",
        ] {
            assert_eq!(job.name(&keys, wide), None, "{wide}");
        }
        assert_eq!(Door::Job.name(&keys, "fleet/job/*"), Some("*"));
        assert_eq!(Door::Job.name(&keys, "fleet/job/**"), None);
        assert_eq!(Door::JobCancel.name(&keys, "fleet/job/**"), None);
        assert_eq!(Door::JobCancel.name(&keys, "fleet/job/a/cancel"), Some("a"));
    }

    #[test]
    fn a_door_hears_its_own_keys() {
        let keys = Keys::default();
        for door in [
            Door::Node(NodeTopic::Job),
            Door::GroupJob,
            Door::Job,
            Door::JobCancel,
            Door::LabelJob,
            Door::ManageNode,
            Door::ManageJob,
        ] {
            assert_eq!(door.name(&keys, &door.key(&keys)), Some("*"), "{door:?}");
        }
    }
}

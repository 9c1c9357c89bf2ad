//! `fleet init` and `fleet users`: who may connect to a secured fleet.

use crate::{
    args::{Init, Keys, KeysAct, Users, UsersAct},
    link::Failure,
    show,
};
use gateway::security::{
    Home, HomeError, Role,
    home::{NODES_PORT, TLS_PORT},
};
use std::path::Path;

impl From<HomeError> for Failure {
    fn from(error: HomeError) -> Self {
        Self::Usage(error.to_string())
    }
}

/// `fleet init`
pub(crate) fn init(init: &Init, json: bool) -> Result<(), Failure> {
    let mut home = Home::init(&init.folder, &init.hosts)?;
    let file = home.add(init.operator, Role::Operator)?;
    let folder = init.folder.display();
    if json {
        let made = serde_json::json!({"folder": init.folder, "credentials": file});
        show::line(&made.to_string());
        return Ok(());
    }
    show::line(&format!(
        "made the secured fleet {folder}; its secrets are readable by you only"
    ));
    show::line(&format!(
        "  people connect by tls, port {TLS_PORT}; nodes by tls, too, with --ca {folder}/ca.pem, or by \
         tcp, port {NODES_PORT}"
    ));
    show::line(&format!("  fleet serve --secure {folder}"));
    show::line(&format!("  fleet --credentials {} nodes", file.display()));
    show::line(&format!(
        "  fleet users {folder} add NAME --role operator|viewer|node"
    ));
    Ok(())
}

/// `fleet users`
pub(crate) fn users(users: &Users, json: bool) -> Result<(), Failure> {
    let mut home = Home::open(&users.folder)?;
    match &users.act {
        UsersAct::Add {
            role: Role::Gateway,
            ..
        } => Err(Failure::Usage(
            "there is one gateway, and `fleet init` made it".into(),
        )),
        UsersAct::Add { name, role } => {
            let file = home.add(*name, *role)?;
            if json {
                let added =
                    serde_json::json!({"user": name, "role": role.as_str(), "credentials": file});
                show::line(&added.to_string());
                return Ok(());
            }
            show::line(&format!(
                "{name} may connect as {role} from the gateway's next start"
            ));
            say_where(&file, *role);
            Ok(())
        }
        UsersAct::Revoke { name } => {
            home.revoke(name)?;
            if json {
                show::line(&serde_json::json!({"revoked": name}).to_string());
            } else {
                show::line(&format!(
                    "{name} may not connect any more from the gateway's next start"
                ));
            }
            Ok(())
        }
        UsersAct::List => {
            for user in home.users() {
                if json {
                    let told = serde_json::json!({"user": user.name, "role": user.role.as_str()});
                    show::line(&told.to_string());
                } else {
                    show::line(&format!("{:<32} {}", user.name.as_str(), user.role));
                }
            }
            Ok(())
        }
    }
}

/// `fleet keys`
pub(crate) fn keys(keys: &Keys, json: bool) -> Result<(), Failure> {
    let mut home = Home::open(&keys.folder)?;
    let signers = keys.folder.join("signers");
    match &keys.act {
        KeysAct::New { name } => {
            let file = home.add_signer(*name)?;
            if json {
                let made = serde_json::json!({"signer": name, "key": file, "signers": signers});
                show::line(&made.to_string());
                return Ok(());
            }
            show::line(&format!(
                "hand {} to {name} and to nobody else",
                file.display()
            ));
            show::line(&format!(
                "  from their next start the gateway takes signed jobs only, and so does each node that has {}",
                signers.display()
            ));
            Ok(())
        }
        KeysAct::Revoke { name } => {
            home.revoke_signer(name)?;
            if json {
                show::line(&serde_json::json!({"revoked": name}).to_string());
            } else {
                show::line(&format!(
                    "the signature of {name} does not count from the gateway's next start; give {} to each node",
                    signers.display()
                ));
                if home.signers()?.is_empty() {
                    show::line(
                        "nobody is left who can sign: no job is taken then, until there is a key (new) or signatures are not asked for any more (off)",
                    );
                }
            }
            Ok(())
        }
        KeysAct::Off => {
            home.sign_no_more()?;
            if json {
                show::line(&serde_json::json!({"signing": false}).to_string());
            } else {
                show::line(
                    "from its next start the gateway takes jobs without a signature; a node asks for one until it is told otherwise (fleet provision PORT --no-signers)",
                );
            }
            Ok(())
        }
        KeysAct::List => {
            for signer in home.signers()? {
                if json {
                    let told = serde_json::json!({"signer": signer.name, "key": signer.key});
                    show::line(&told.to_string());
                } else {
                    show::line(&format!("{:<32} {}", signer.name.as_str(), signer.key));
                }
            }
            Ok(())
        }
    }
}

fn say_where(file: &Path, role: Role) {
    let file = file.display();
    match role {
        Role::Node => show::line(&format!(
            "  tell the node: fleet provision PORT --login {file}"
        )),
        _ => show::line(&format!(
            "  hand out {file}: fleet --credentials {file} nodes"
        )),
    }
}

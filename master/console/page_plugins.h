#pragma once

#include <map>
#include <memory>
#include <string>
#include <vector>

#include <iotcloud/config/mutex.h>
#include <iotcloud/security/plugin_versions.h>
#include <iotcloud/security/trusted_keys.h>

namespace iotcloud::master {

/// Where pages for robots are, who may sign them, and which of their versions may be shown.
struct PagePluginSettings {
  std::vector<std::string> folders;                        ///< empty: there are no such pages
  std::shared_ptr<const security::TrustedKeys> signers{};  ///< null: no key is trusted, and none needs a signature
  /// Keeps the versions of signed pages that were shown, so that an older one is not shown again; null: versions in
  /// signatures are not looked at.
  std::shared_ptr<security::PluginVersions> versions{};
};

/// Pages of robots, each a plugin of the console: a script NAME.js, and its signature NAME.js.sig if it is signed. The
/// files are read and their signatures are looked at when somebody asks, so what was changed counts at once. Thread
/// safe.
class PagePlugins {
 public:
  /// What people are told of a page.
  struct Listed {
    std::string name;       ///< the file's, without its ending
    std::string title;      ///< for people
    std::string driver;     ///< the page is for instances of this driver
    std::string signed_by;  ///< the trusted key; empty: none
    std::string problem;    ///< why it is not shown; empty: it is
  };
  /// What a browser gets for a page.
  struct Document {
    std::string html;    ///< nothing but the script in it
    std::string policy;  ///< for the header Content-Security-Policy: this script only, no network, an origin of its own
  };

  explicit PagePlugins(PagePluginSettings settings) : settings_(std::move(settings)) {}

  /// All of them, by name. Of two with the same name the one in the folder that was named first counts. A problem is
  /// logged when it is found first.
  std::vector<Listed> list() const;
  /// \throws config::Error that says why there is none
  Document document(const std::string& name) const;

 private:
  struct Page {
    Listed listed;
    std::string script;
  };
  std::map<std::string, std::string> files() const;
  Page read(const std::string& name, const std::string& file) const;
  void note(const Listed& page) const IOTCLOUD_EXCLUDES(mutex_);

  const PagePluginSettings settings_;
  mutable config::Mutex mutex_;
  mutable std::map<std::string, std::string> problems_ IOTCLOUD_GUARDED_BY(mutex_);  ///< that were logged, by name
};

}  // namespace iotcloud::master

#include "iotcloud/brokers/broker_setting.h"

#include <algorithm>
#include <filesystem>

namespace iotcloud::brokers {
namespace {

Tls read_tls(config::YamlSection section) {
  Tls tls;
  tls.ca_file = section.string_or("ca", "");
  tls.certificate_file = section.string_or("certificate", "");
  tls.key_file = section.string_or("key", "");
  tls.revoked_file = section.string_or("revoked", "");
  if (tls.certificate_file.empty() != tls.key_file.empty()) {
    section.refuse("", "a client certificate needs both \"certificate\" and \"key\"", "give both, or none");
  }
  section.finish();
  return tls;
}

/// \param options BrokerOptions, const or not. \param visit gets the key in the section and the file
template <class Options, class Visit>
void for_each_file(Options& options, const Visit& visit) {
  const auto visit_named = [&](const char* key, auto& file) {
    if (!file.empty()) visit(key, file);
  };
  visit_named("password_file", options.password_file);
  visit_named("tls.ca", options.tls.ca_file);
  visit_named("tls.certificate", options.tls.certificate_file);
  visit_named("tls.key", options.tls.key_file);
  visit_named("tls.revoked", options.tls.revoked_file);
  const auto of_reader = options.properties.find("reader_password_file");
  if (of_reader != options.properties.end()) visit_named("properties.reader_password_file", of_reader->second);
}

}  // namespace

BrokerOptions read_broker_options(config::YamlSection& section, std::chrono::milliseconds session_timeout) {
  using std::chrono::milliseconds;
  BrokerOptions options;
  options.urls = section.strings_or("urls", {});
  for (const std::string& url : options.urls) {
    try {
      static_cast<void>(broker_kind(url));
    } catch (const config::Error& error) {
      section.refuse("urls", error.what());
    }
  }
  options.user = section.string_or("user", "");
  options.password_file = section.string_or("password_file", "");
  options.password_variable = section.string_or("password_variable", "");
  if (!options.password_file.empty() && !options.password_variable.empty()) {
    section.refuse("password_variable", "the password is in \"password_file\" already", "remove one of the two");
  }
  if (auto tls = section.optional_section("tls")) options.tls = read_tls(*tls);
  const milliseconds most = session_timeout / 2;
  options.heartbeat =
      std::chrono::duration_cast<milliseconds>(section.duration_or("heartbeat", usual_heartbeat(session_timeout)));
  if (options.heartbeat > most || options.heartbeat < milliseconds(100)) {
    section.refuse("heartbeat",
                   "it must be from 100 ms to half of the registry's session time-out, " +
                       std::to_string(most.count()) + " ms, so that a reader that froze is cut off in time",
                   "leave it out, or lengthen registry.session_timeout");
  }
  options.properties = section.string_map("properties");
  for (const auto& [key, file] : files_of(options)) {
    if (!section.runs_here() || std::filesystem::exists(file)) continue;
    section.refuse(key, "the file \"" + file + "\" is not there", "make it, or name another");
  }
  return options;
}

std::map<std::string, std::string> files_of(const BrokerOptions& options) {
  std::map<std::string, std::string> files;
  for_each_file(options, [&](const char* key, const std::string& file) { files.emplace(key, file); });
  return files;
}

void change_files(BrokerOptions& options, const std::function<void(std::string& file)>& change) {
  for_each_file(options, [&](const char*, std::string& file) { change(file); });
}

bool are_credentials_given(const BrokerOptions& options) {
  return !options.user.empty() || !options.password_file.empty() || !options.password_variable.empty() ||
         options.tls != Tls{};
}

std::chrono::milliseconds usual_heartbeat(std::chrono::milliseconds session_timeout) {
  return std::min<std::chrono::milliseconds>(
      {BrokerOptions{}.heartbeat, session_timeout / 2, (session_timeout + std::chrono::seconds(2)) / 3});
}

}  // namespace iotcloud::brokers

#pragma once

#include <chrono>
#include <string>
#include <vector>

#include <iotcloud/config/yaml.h>
#include <iotcloud/master/console/page_plugins.h>
#include <iotcloud/rpc/http/page_settings.h>

namespace iotcloud::master {

/// Where a master serves its console, and for whom.
struct ConsoleSettings {
  rpc::PageSettings pages;  ///< address (empty: no console) and TLS; `tokens` is the API's file
  std::chrono::milliseconds session{12 * 3'600'000};  ///< a log-in counts for so long
  std::chrono::milliseconds idle{3'600'000};          ///< and ends when nothing was asked for so long
  std::vector<std::string> names;                     ///< more names by which browsers reach it ("lab1.example.org")
  std::vector<std::string> others;                    ///< the consoles of the other masters ("https://lab2:9114")
  PagePluginSettings page_plugins;
};

/// Reads `console: {address, tls, session, idle, names, others, pages}`. Without the section there is no console.
/// \param tokens the file of the API's tokens, by which people log in; empty: there is none
/// \throws ConfigError, also when other machines could reach it without TLS and tokens.
ConsoleSettings read_console_settings(config::YamlSection& top, const std::string& tokens);

}  // namespace iotcloud::master

#include <map>

#include <iotcloud/master/console/page_files.h>
#include <iotcloud/security/sha256.h>

// Puts a file into the program, between two symbols.
#define IOTCLOUD_PAGE_FILE(symbol, file)                                                     \
  __asm__(".section .rodata\n.globl iotcloud_page_" #symbol "\niotcloud_page_" #symbol       \
          ":\n.incbin \"" IOTCLOUD_CONSOLE_PAGE "/" file "\"\n.globl iotcloud_page_" #symbol \
          "_end\niotcloud_page_" #symbol "_end:\n.byte 0\n.previous\n");                     \
  extern "C" const char iotcloud_page_##symbol[];                                            \
  extern "C" const char iotcloud_page_##symbol##_end[];

IOTCLOUD_PAGE_FILE(html, "index.html")
IOTCLOUD_PAGE_FILE(js, "console.js")
IOTCLOUD_PAGE_FILE(plot, "plot.js")
IOTCLOUD_PAGE_FILE(layout, "layout.js")
IOTCLOUD_PAGE_FILE(css, "console.css")
IOTCLOUD_PAGE_FILE(icon, "icon.svg")
IOTCLOUD_PAGE_FILE(land, "land.json")

namespace iotcloud::master {

namespace {

PageFile file_between(const char* begin, const char* end, const char* content_type) {
  const std::string_view bytes(begin, static_cast<std::size_t>(end - begin));
  return {bytes, content_type, '"' + security::short_sha256(security::sha256_hex(bytes)) + '"'};
}

}  // namespace

const PageFile* find_page_file(const std::string& path) {
  static const std::map<std::string, PageFile> files{
      {"/", file_between(iotcloud_page_html, iotcloud_page_html_end, "text/html; charset=utf-8")},
      {"/console.js", file_between(iotcloud_page_js, iotcloud_page_js_end, "text/javascript; charset=utf-8")},
      {"/plot.js", file_between(iotcloud_page_plot, iotcloud_page_plot_end, "text/javascript; charset=utf-8")},
      {"/layout.js", file_between(iotcloud_page_layout, iotcloud_page_layout_end, "text/javascript; charset=utf-8")},
      {"/console.css", file_between(iotcloud_page_css, iotcloud_page_css_end, "text/css; charset=utf-8")},
      {"/icon.svg", file_between(iotcloud_page_icon, iotcloud_page_icon_end, "image/svg+xml")},
      {"/land.json", file_between(iotcloud_page_land, iotcloud_page_land_end, "application/json")},
  };
  const auto found = files.find(path);
  return found == files.end() ? nullptr : &found->second;
}

}  // namespace iotcloud::master

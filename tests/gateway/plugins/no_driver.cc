// A shared library that is no driver plugin.
extern "C" __attribute__((visibility("default"))) int iotcloud_no_driver() {
  return 0;
}

package iotcloud.storm;

/** The byte before a value, as topology/storm/value_format.h describes them. */
final class ValueKind {
  static final byte NULL = 0;
  static final byte NO = 1;
  static final byte YES = 2;
  static final byte INTEGER = 3;
  static final byte REAL = 4;
  static final byte STRING = 5;
  static final byte PAYLOAD = 6;
  static final byte OF_TUPLE = 7;
  static final byte ARRAY = 8;

  private ValueKind() {}
}

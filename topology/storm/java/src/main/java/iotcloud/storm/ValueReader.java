package iotcloud.storm;

import java.nio.ByteBuffer;
import java.nio.charset.StandardCharsets;
import java.util.ArrayDeque;
import java.util.Queue;

/** Reads values that C++ wrote, as topology/storm/value_format.h describes them. One call at a time. */
final class ValueReader {
  private static final byte NULL = 0;
  private static final byte NO = 1;
  private static final byte YES = 2;
  private static final byte INTEGER = 3;
  private static final byte REAL = 4;
  private static final byte STRING = 5;
  private static final byte OF_TUPLE = 7;
  private static final byte ARRAY = 8;

  /** A value of a tuple that C++ has not answered yet. */
  interface Kept {
    Object value(int slot, int place);
  }

  private final Kept kept;
  private final Queue<byte[]> arrays = new ArrayDeque<>();
  private byte[] scratch = new byte[64];

  ValueReader(Kept kept) {
    this.kept = kept;
  }

  /** Adds a value that is not among the bytes. */
  void addArray(byte[] array) {
    arrays.add(array);
  }

  Object value(ByteBuffer from) {
    switch (from.get()) {
      case NULL:
        return null;
      case NO:
        return Boolean.FALSE;
      case YES:
        return Boolean.TRUE;
      case INTEGER:
        return from.getLong();
      case REAL:
        return from.getDouble();
      case STRING:
        return text(from);
      case OF_TUPLE:
        return kept.value(from.getInt(), from.getInt());
      case ARRAY:
        return arrays.remove();
      default:
        return bytes(from);
    }
  }

  /** A count, and as many bytes of UTF-8. */
  String text(ByteBuffer from) {
    int size = from.getInt();
    if (size > scratch.length) {
      scratch = new byte[size];
    }
    from.get(scratch, 0, size);
    return new String(scratch, 0, size, StandardCharsets.UTF_8);
  }

  private static byte[] bytes(ByteBuffer from) {
    byte[] bytes = new byte[from.getInt()];
    from.get(bytes);
    return bytes;
  }
}

/* zig.exe: passes its arguments to SCRIPT, which runs the zig of this machine, and waits for its end. */
#include <stdio.h>
#include <windows.h>

#define WIDE_(x) L##x
#define WIDE(x) WIDE_(x)

int wmain(int argc, wchar_t **argv) {
    (void)argc;
    static wchar_t folder[MAX_PATH], done[MAX_PATH], command[32768];
    STARTUPINFOW start = {.cb = sizeof start};
    PROCESS_INFORMATION process;
    int status = -1;
    const wchar_t *arguments = GetCommandLineW();
    arguments += wcslen(argv[0]) + (arguments[0] == '"' ? 2 : 0);
    GetTempPathW(MAX_PATH, folder);
    GetTempFileNameW(folder, L"zig", 0, done);
    swprintf(command, 32768, L"\"%ls\" \"%ls\" \"%ls\" %ls", WIDE(PYTHON), WIDE(SCRIPT), done, arguments);
    /* Wine starts a program of Linux in this folder, but returns no handle to wait for, and passes no pipe */
    if (!CreateProcessW(L"\\\\?\\unix" WIDE(PYTHON), command, 0, 0, TRUE, 0, 0, 0, &start, &process)) return 97;
    for (FILE *file = 0; status == -1; Sleep(10)) {
        if (!(file = _wfopen(done, L"rb"))) continue;
        if (fscanf(file, "%d.", &status) != 1) status = -1;
        for (int c; status != -1 && (c = fgetc(file)) != EOF;) putchar(c);
        fclose(file);
    }
    DeleteFileW(done);
    return status;
}
